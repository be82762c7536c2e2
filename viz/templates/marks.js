// The measured points, their error vectors and the mark of the chosen pose. Everything that the controls change is a
// uniform of a shader, so that thousands of poses cost nothing per change.
"use strict";

const EDGES = { light: [0.10, 0.12, 0.16], dark: [0.92, 0.94, 0.96] }; // of points, on a light and on a dark ground
const UNKNOWN = 1e9; // stands for an error that is not known: shaders cannot be trusted with NaN

const SHARED_SHADER = `
  attribute vec3 place; attribute vec3 before; attribute vec3 after; attribute vec2 sizes;
  attribute float group; attribute float shape; attribute float outlier; attribute float part; attribute float dim;
  uniform float chosenPart; uniform float state; uniform float low; uniform float high; uniform float logarithmic;
  uniform float visible[CODES]; uniform sampler2D colours;
  varying vec3 vColour; varying float vShape; varying float vOutlier;
  vec3 chosenError() { // between both states while one becomes the other; an unknown error has nothing between
    bool known = max(length(before), length(after)) < 1e6;
    return known ? mix(before, after, state) : state < 0.5 ? before : after;
  }
  bool isVisible() { return abs(part - chosenPart) < 0.5 && visible[int(group + 0.5)] > 0.5; }
  void colour() {
    bool both = max(sizes.x, sizes.y) < 1e6;
    float size = both ? mix(sizes.x, sizes.y, state) : state < 0.5 ? sizes.x : sizes.y;
    float along = logarithmic > 0.5 ? log(max(size, 1e-12) / low) / log(high / low) : (size - low) / (high - low);
    vColour = size < 1e6 ? texture2D(colours, vec2(clamp(along, 0.002, 0.998), 0.5)).rgb : vec3(0.55);
    vColour = mix(vColour, vec3(0.6), 0.85 * dim); // beside those that are selected
    vShape = shape;
    vOutlier = outlier;
  }`;

const POINT_VERTEX = `
  uniform float radius; uniform float pixels; uniform float smallest; uniform float size; varying float vEdge;
  void main() {
    colour();
    vec4 seen = modelViewMatrix * vec4(place, 1.0);
    gl_Position = isVisible() ? projectionMatrix * seen : vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = (1.0 - 0.55 * dim) * size * max(smallest, pixels * projectionMatrix[1][1] * radius / -seen.z);
    vEdge = (1.0 - dim) * clamp((gl_PointSize - 3.0) / 6.0, 0.3, 1.0); // a full edge would leave small points no colour
  }`;

// Shapes tell the groups apart without colour; a cross through one marks an outlier, used or left out.
const SHAPES = ["disc", "diamond", "square", "alarm"]; // the last is a square in red

const POINT_FRAGMENT = `
  uniform vec3 edge; uniform float opacity; varying vec3 vColour; varying float vShape; varying float vOutlier; varying float vEdge;
  void main() {
    vec2 p = 2.0 * gl_PointCoord - 1.0;
    int shape = int(vShape + 0.5);
    float reach = shape == DISC ? length(p) : shape == DIAMOND ? abs(p.x) + abs(p.y) : max(abs(p.x), abs(p.y)) * 1.15;
    float cross = min(abs(p.x - p.y), abs(p.x + p.y));
    if (vOutlier > 0.5 && cross < 0.28 && max(abs(p.x), abs(p.y)) < 0.98) {
      gl_FragColor = vec4(cross < 0.13 ? vec3(0.0) : vec3(1.0), opacity);
      return;
    }
    if (reach > 1.0) discard;
    vec3 colour = shape == ALARM ? vec3(0.85, 0.08, 0.08) : vColour;
    gl_FragColor = vec4(reach > 0.76 ? mix(colour, edge, vEdge) : colour, opacity);
  }`;

// A slender cone from the measured point to the exaggerated predicted point; the tip shows the direction.
const VECTOR_VERTEX = `
  uniform float factor; uniform float thickness; uniform float size; varying float vShade;
  void main() {
    colour();
    vec3 along = factor * chosenError();
    float reach = length(along);
    if (!isVisible() || reach < 1e-9 || reach > 1e6) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
    vec3 axis = along / reach;
    vec3 helper = abs(axis.z) < 0.8 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0);
    vec3 side = normalize(cross(axis, helper));
    vec3 other = cross(axis, side);
    float wide = min(size * thickness, 0.12 * reach + 0.25 * size * thickness);
    vec3 around = position.x * side + position.z * other;
    vec4 seen = modelViewMatrix * vec4(place + position.y * along + wide * around, 1.0);
    vShade = 0.72 + 0.28 * max(0.0, normalize(normalMatrix * (around + 0.0001)).z);
    gl_Position = projectionMatrix * seen;
  }`;

const VECTOR_FRAGMENT = `
  varying vec3 vColour; varying float vShade;
  void main() { gl_FragColor = vec4(vColour * vShade, 1.0); }`;

const RING_VERTEX = `
  uniform float pixels; uniform float radius; uniform float smallest; uniform float size;
  void main() {
    vec4 place = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * place;
    gl_PointSize = 2.1 * size * max(smallest, pixels * projectionMatrix[1][1] * radius / -place.z) + 10.0;
  }`;

const RING_FRAGMENT = `
  void main() {
    float r = length(2.0 * gl_PointCoord - 1.0);
    if (r > 1.0 || r < 0.66) discard;
    gl_FragColor = r > 0.93 || r < 0.73 ? vec4(1.0, 1.0, 1.0, 1.0) : vec4(0.80, 0.05, 0.35, 1.0);
  }`;

/** Colours from small to large, to be looked up by shaders. @param colours 256 x 4 bytes */
function colourTexture(THREE, colours) {
  const texture = new THREE.DataTexture(colours, colours.length / 4, 1, THREE.RGBAFormat);
  texture.magFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

class Marks {
  /**
   * @param THREE the library
   * @param table a PoseTable
   * @param colours 256 x 4 bytes
   * @param radius of a point [m]
   * @param smallest width of a point [px]
   */
  constructor(THREE, table, colours, radius, smallest) {
    this.THREE = THREE;
    this.table = table;
    this.radius = radius;
    const texture = colourTexture(THREE, colours);
    this.uniforms = {
      chosenPart: { value: 0 }, state: { value: 0 }, low: { value: 1e-5 }, high: { value: 1e-2 }, logarithmic: { value: 1 },
      visible: { value: new Array(2 * table.nGroups).fill(1) }, colours: { value: texture }, radius: { value: radius },
      pixels: { value: 800 }, smallest: { value: smallest }, size: { value: 1 }, factor: { value: 1 }, thickness: { value: 0.42 * radius },
      edge: { value: EDGES.light },
    };
    this.points = new THREE.Points(this.pointGeometry(), this.material(SHARED_SHADER + POINT_VERTEX, POINT_FRAGMENT));
    this.covered = new THREE.Points(this.points.geometry, this.material(SHARED_SHADER + POINT_VERTEX, POINT_FRAGMENT, 0.35));
    Object.assign(this.covered.material, { depthFunc: THREE.GreaterDepth, depthWrite: false }); // in or behind the robot: faint
    this.vectors = new THREE.Mesh(this.cones(), this.material(SHARED_SHADER + VECTOR_VERTEX, VECTOR_FRAGMENT));
    this.ring = this.ringMark();
    this.objects = [this.covered, this.points, this.vectors, this.ring];
    for (const object of this.objects) {
      object.frustumCulled = false;
      object.material.transparent = true; // drawn last, so that a translucent workspace does not veil them
      object.renderOrder = object === this.ring ? 10 : object === this.covered ? 2.5 : 3; // covered by the robot, not by points
    }
  }

  material(vertexShader, fragmentShader, opacity = 1) {
    const defines = { CODES: 2 * this.table.nGroups };
    SHAPES.forEach((shape, number) => { defines[shape.toUpperCase()] = number; });
    const uniforms = { ...this.uniforms, opacity: { value: opacity } };
    return new this.THREE.ShaderMaterial({ uniforms, defines, vertexShader, fragmentShader });
  }

  /** A geometry with what the shaders need of every row, `corners` times each. */
  geometry(corners = 1) {
    const geometry = new this.THREE.BufferGeometry();
    const known = (value) => (Number.isNaN(value) ? UNKNOWN : value);
    const shapes = this.table.groups.map(({ mark }) => SHAPES.indexOf(mark));
    const { n, place, before, after, group, part } = this.table;
    const add = (name, width, value) => {
      const array = new Float32Array(n * corners * width);
      for (let k = 0; k < array.length; k += 1) {
        array[k] = value(Math.floor(k / (width * corners)), k % width);
      }
      geometry.setAttribute(name, new this.THREE.BufferAttribute(array, width));
    };
    add("place", 3, (row, axis) => place[3 * row + axis]);
    add("before", 3, (row, axis) => known(before[3 * row + axis]));
    add("after", 3, (row, axis) => known(after[3 * row + axis]));
    add("sizes", 2, (row, k) => known(this.table.error(k ? "after" : "before", row)));
    add("part", 1, (row) => part[row]);
    add("group", 1, (row) => group[row]);
    add("shape", 1, (row) => shapes[this.table.kind(row)]);
    add("dim", 1, () => 0);
    add("outlier", 1, (row) => Number(this.table.isOutlier(row)));
    return geometry;
  }

  pointGeometry() {
    const geometry = this.geometry();
    geometry.setAttribute("position", geometry.attributes.place);
    return geometry;
  }

  /** All cones as one mesh: without a graphics card, thousands of instances would be drawn one by one. */
  cones() {
    const { n } = this.table;
    const sides = n > 1000 ? 3 : 5; // few corners: all are drawn in every frame
    const corners = sides + 1;
    const geometry = this.geometry(corners);
    const shape = [[0, 1, 0], ...Array.from({ length: sides }, (_, i) => 2 * Math.PI * i / sides)
      .map((angle) => [Math.cos(angle), 0, Math.sin(angle)])];
    const position = new Float32Array(3 * n * corners);
    const triangles = new Uint32Array(3 * n * sides);
    for (let row = 0; row < n; row += 1) {
      position.set(shape.flat(), 3 * row * corners);
      for (let i = 0; i < sides; i += 1) {
        const first = row * corners;
        triangles.set([first, first + 1 + (i + 1) % sides, first + 1 + i], 3 * (row * sides + i));
      }
    }
    geometry.setAttribute("position", new this.THREE.BufferAttribute(position, 3));
    geometry.setIndex(new this.THREE.BufferAttribute(triangles, 1));
    return geometry;
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

  /** Let rows that are not selected stand back. @param chosen of each row whether it is; @param any whether one is */
  select(chosen, any) {
    for (const { geometry } of [this.points, this.vectors]) {
      const { dim } = geometry.attributes;
      const corners = dim.count / this.table.n;
      for (let k = 0; k < dim.count; k += 1) dim.array[k] = Number(any && !chosen[Math.floor(k / corners)]);
      dim.needsUpdate = true;
    }
  }

  /** Whether a row is of the part and of a group that are shown. */
  shows(row) {
    return this.table.part[row] === this.uniforms.chosenPart.value && this.uniforms.visible.value[this.table.group[row]] > 0;
  }

  /** Row whose point is drawn nearest to a place on the canvas; -1 if none is within reach [px]. */
  pick(camera, x, y, width, height, reach) {
    const point = new this.THREE.Vector3();
    const { place, n } = this.table;
    let best = -1;
    let bestCost = Infinity;
    for (let row = 0; row < n; row += 1) {
      if (!this.shows(row)) continue;
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
