// The measured points, their error vectors and the mark of the chosen pose. Everything that the controls change is a
// uniform of a shader, so that thousands of poses cost nothing per change.
"use strict";

const UNKNOWN = 1e9; // stands for an error that is not known: shaders cannot be trusted with NaN

const SHARED_SHADER = `
  attribute vec3 place; attribute vec3 before; attribute vec3 after; attribute float group;
  uniform float state; uniform float low; uniform float high; uniform float logarithmic;
  uniform float visible[8]; uniform sampler2D colours;
  varying vec3 vColour; varying float vGroup;
  vec3 chosenError() { return state < 0.5 ? before : after; }
  bool isVisible() { int code = int(group + 0.5); for (int i = 0; i < 8; i++) if (i == code) return visible[i] > 0.5; return false; }
  void colour() {
    float size = length(chosenError());
    float part = logarithmic > 0.5 ? log(max(size, 1e-12) / low) / log(high / low) : (size - low) / (high - low);
    bool known = size < 1e6;
    vColour = known ? texture2D(colours, vec2(clamp(part, 0.002, 0.998), 0.5)).rgb : vec3(0.55);
    vGroup = group;
  }`;

const POINT_VERTEX = `
  uniform float radius; uniform float pixels; uniform float smallest;
  void main() {
    colour();
    vec4 seen = modelViewMatrix * vec4(place, 1.0);
    gl_Position = isVisible() ? projectionMatrix * seen : vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = max(smallest, pixels * projectionMatrix[1][1] * radius / -seen.z);
  }`;

// Shapes tell the groups apart without colour: disc = identification, square on its corner = validation, square = only
// measured; a cross through it marks an outlier, used or left out.
const POINT_FRAGMENT = `
  varying vec3 vColour; varying float vGroup;
  void main() {
    vec2 p = 2.0 * gl_PointCoord - 1.0;
    float code = floor(vGroup + 0.5);
    bool outlier = code > 3.5;
    float kind = outlier ? code - 4.0 : code;
    float reach = kind < 0.5 || kind > 2.5 ? length(p) : kind < 1.5 ? abs(p.x) + abs(p.y) : max(abs(p.x), abs(p.y)) * 1.15;
    float cross = min(abs(p.x - p.y), abs(p.x + p.y));
    if (outlier && cross < 0.28 && max(abs(p.x), abs(p.y)) < 0.98) {
      gl_FragColor = vec4(cross < 0.13 ? vec3(0.0) : vec3(1.0), 1.0);
      return;
    }
    if (reach > 1.0) discard;
    gl_FragColor = vec4(reach > 0.76 ? vec3(0.10, 0.12, 0.16) : vColour, 1.0);
  }`;

// A slender cone from the measured point to the exaggerated predicted point; the tip shows the direction.
const VECTOR_VERTEX = `
  uniform float factor; uniform float thickness; varying float vShade;
  void main() {
    colour();
    vec3 along = factor * chosenError();
    float size = length(along);
    if (!isVisible() || size < 1e-9 || size > 1e6) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
    vec3 axis = along / size;
    vec3 helper = abs(axis.z) < 0.8 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0);
    vec3 side = normalize(cross(axis, helper));
    vec3 other = cross(axis, side);
    float wide = min(thickness, 0.12 * size + 0.25 * thickness);
    vec3 around = position.x * side + position.z * other;
    vec4 seen = modelViewMatrix * vec4(place + position.y * along + wide * around, 1.0);
    vShade = 0.72 + 0.28 * max(0.0, normalize(normalMatrix * (around + 0.0001)).z);
    gl_Position = projectionMatrix * seen;
  }`;

const VECTOR_FRAGMENT = `
  varying vec3 vColour; varying float vShade;
  void main() { gl_FragColor = vec4(vColour * vShade, 1.0); }`;

const RING_VERTEX = `
  uniform float pixels; uniform float radius; uniform float smallest;
  void main() {
    vec4 place = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * place;
    gl_PointSize = 2.1 * max(smallest, pixels * projectionMatrix[1][1] * radius / -place.z) + 10.0;
  }`;

const RING_FRAGMENT = `
  void main() {
    float r = length(2.0 * gl_PointCoord - 1.0);
    if (r > 1.0 || r < 0.66) discard;
    gl_FragColor = r > 0.93 || r < 0.73 ? vec4(1.0, 1.0, 1.0, 1.0) : vec4(0.80, 0.05, 0.35, 1.0);
  }`;

class Marks {
  /**
   * @param THREE the library
   * @param table n, place (of the point), before and after (error vectors), group (codes): typed arrays
   * @param colours 256 x 4 bytes
   * @param radius of a point [m]
   */
  constructor(THREE, table, colours, radius) {
    this.THREE = THREE;
    this.table = table;
    this.radius = radius;
    const texture = new THREE.DataTexture(colours, colours.length / 4, 1, THREE.RGBAFormat);
    texture.magFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    this.uniforms = {
      state: { value: 0 }, low: { value: 1e-5 }, high: { value: 1e-2 }, logarithmic: { value: 1 },
      visible: { value: [1, 1, 1, 1, 1, 1, 1, 1] }, colours: { value: texture }, radius: { value: radius },
      pixels: { value: 800 }, smallest: { value: 7 }, factor: { value: 1 }, thickness: { value: 0.42 * radius },
    };
    this.points = new THREE.Points(this.geometry(new THREE.BufferGeometry(), THREE.BufferAttribute),
                                   this.material(SHARED_SHADER + POINT_VERTEX, POINT_FRAGMENT));
    this.vectors = new THREE.Mesh(this.cones(), this.material(SHARED_SHADER + VECTOR_VERTEX, VECTOR_FRAGMENT));
    this.ring = this.ringMark();
    for (const object of [this.points, this.vectors, this.ring]) {
      object.frustumCulled = false;
      object.material.transparent = true; // drawn last, so that a translucent workspace does not veil them
      object.renderOrder = object === this.ring ? 10 : 3;
    }
  }

  material(vertexShader, fragmentShader) {
    return new this.THREE.ShaderMaterial({ uniforms: this.uniforms, vertexShader, fragmentShader });
  }

  geometry(geometry, Attribute) {
    const known = (values) => Float32Array.from(values, (value) => (Number.isNaN(value) ? UNKNOWN : value));
    const { place, before, after, group } = this.table;
    geometry.setAttribute("place", new Attribute(new Float32Array(place), 3));
    geometry.setAttribute("before", new Attribute(known(before), 3));
    geometry.setAttribute("after", new Attribute(known(after), 3));
    geometry.setAttribute("group", new Attribute(new Float32Array(group), 1));
    if (!geometry.attributes.position) {
      geometry.setAttribute("position", geometry.attributes.place);
    }
    return geometry;
  }

  cones() {
    const sides = 5; // few corners: there may be thousands of cones
    const corners = [0, 1, 0];
    const triangles = [];
    for (let i = 0; i < sides; i += 1) {
      corners.push(Math.cos(2 * Math.PI * i / sides), 0, Math.sin(2 * Math.PI * i / sides));
      triangles.push(0, 1 + (i + 1) % sides, 1 + i);
    }
    const instanced = new this.THREE.InstancedBufferGeometry();
    instanced.setIndex(triangles);
    instanced.setAttribute("position", new this.THREE.Float32BufferAttribute(corners, 3));
    instanced.instanceCount = this.table.n;
    return this.geometry(instanced, this.THREE.InstancedBufferAttribute);
  }

  ringMark() {
    const geometry = new this.THREE.BufferGeometry();
    geometry.setAttribute("position", new this.THREE.BufferAttribute(new Float32Array(3), 3));
    const material = this.material(RING_VERTEX, RING_FRAGMENT);
    material.depthTest = false;
    const ring = new this.THREE.Points(geometry, material);
    ring.visible = false;
    return ring;
  }

  /** Put the ring around a row's point; -1 hides it. */
  choose(row) {
    this.ring.visible = row >= 0;
    if (row >= 0) {
      const place = this.ring.geometry.attributes.position;
      place.array.set(this.table.place.slice(3 * row, 3 * row + 3));
      place.needsUpdate = true;
    }
  }

  /** Row whose point is drawn nearest to a place on the canvas; -1 if none is within reach [px]. */
  pick(camera, x, y, width, height, reach) {
    const point = new this.THREE.Vector3();
    const { place, group, n } = this.table;
    let best = -1;
    let bestCost = Infinity;
    for (let row = 0; row < n; row += 1) {
      if (!this.uniforms.visible.value[group[row]]) continue;
      point.fromArray(place, 3 * row);
      this.points.localToWorld(point).project(camera);
      if (point.z < -1 || point.z > 1) continue;
      const distance = Math.hypot((point.x + 1) / 2 * width - x, (1 - point.y) / 2 * height - y);
      if (distance > reach) continue;
      const cost = distance + 200 * point.z; // of two points at one place, the nearer one is in front
      if (cost < bestCost) {
        bestCost = cost;
        best = row;
      }
    }
    return best;
  }
}
