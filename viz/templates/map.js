// What is known over the workspace: a cloud coloured by one of its numbers, whole or in slices, the region that was
// measured, and ellipsoids of uncertainty. Everything that the controls change is a uniform or a visibility.
"use strict";

const MAP_POINT = 5; // [px]
const MAP_TITLES = { error: "Error of the nominal robot [mm]", std: "1\u03c3 of predicted positions [mm]" };
const ELLIPSOID_COLOUR = 0xcc3377;

const MAP_VERTEX = `
  attribute vec3 place; attribute float value; attribute float within;
  uniform float low; uniform float high; uniform float logarithmic; uniform float pixels; uniform float axis;
  uniform float middle; uniform float half_; uniform sampler2D colours;
  varying vec3 vColour; varying float vWithin;
  void main() {
    float along = axis < 0.5 ? place.x : axis < 1.5 ? place.y : place.z;
    bool hidden = value < 0.0 || (axis > -0.5 && abs(along - middle) > half_);
    float part = logarithmic > 0.5 ? log(value / low) / log(high / low) : (value - low) / (high - low);
    vColour = texture2D(colours, vec2(clamp(part, 0.002, 0.998), 0.5)).rgb;
    vWithin = within;
    gl_Position = hidden ? vec4(2.0, 2.0, 2.0, 1.0) : projectionMatrix * modelViewMatrix * vec4(place, 1.0);
    gl_PointSize = within > 0.5 ? 1.5 * pixels : pixels;
  }`;

const MAP_FRAGMENT = `
  varying vec3 vColour; varying float vWithin;
  void main() {
    vec2 p = 2.0 * gl_PointCoord - 1.0;
    bool disc = vWithin > 0.5; // beyond what was measured: a hollow square
    if (disc ? length(p) > 1.0 : max(abs(p.x), abs(p.y)) < 0.45) discard;
    gl_FragColor = vec4(vColour, 1.0);
  }`;

class WorkspaceMap {
  constructor(THREE, data, texture, ratio) {
    this.data = data;
    const floats = (name) => decode(data[name], Float32Array);
    this.values = { error: floats("error"), std: floats("std") };
    this.uniforms = { low: { value: 1 }, high: { value: 2 }, logarithmic: { value: 1 }, pixels: { value: MAP_POINT * ratio },
      axis: { value: -1 }, middle: { value: 0 }, half_: { value: 1 }, colours: { value: texture } };
    const geometry = new THREE.BufferGeometry();
    const places = floats("places");
    geometry.setAttribute("position", new THREE.BufferAttribute(places, 3)); // three.js counts the points by it
    geometry.setAttribute("place", new THREE.BufferAttribute(places, 3));
    geometry.setAttribute("within", new THREE.BufferAttribute(Float32Array.from(decode(data.within, Uint8Array)), 1));
    geometry.setAttribute("value", new THREE.BufferAttribute(new Float32Array(data.n), 1));
    this.points = new THREE.Points(geometry, new THREE.ShaderMaterial({ uniforms: this.uniforms,
      vertexShader: MAP_VERTEX, fragmentShader: MAP_FRAGMENT }));
    this.points.frustumCulled = false;
    this.hull = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: ELLIPSOID_COLOUR }));
    this.hull.geometry.setAttribute("position", new THREE.BufferAttribute(floats("hull"), 3));
    const [low, high] = [0, 1, 2].map((i) => places.filter((_, k) => k % 3 === i))
      .reduce(([l, h], axis) => [[...l, axis.reduce((a, b) => Math.min(a, b))], [...h, axis.reduce((a, b) => Math.max(a, b))]], [[], []]);
    this.box = { low, high };
    const sphere = new THREE.SphereGeometry(1, 16, 10);
    const material = new THREE.MeshLambertMaterial({ color: ELLIPSOID_COLOUR, transparent: true, opacity: 0.7 });
    this.ellipsoids = new THREE.Group();
    for (const centre of data.centres) {
      const one = new THREE.Mesh(sphere, material);
      one.matrixAutoUpdate = false;
      one.userData = centre;
      this.ellipsoids.add(one);
    }
    this.enlarge(data.factor);
    this.show("");
    this.ellipsoids.visible = false;
  }

  /** Colour by `error` or `std`, or hide. Returns the range of colours and whether it is logarithmic. */
  show(kind) {
    this.kind = kind;
    this.points.visible = this.hull.visible = kind !== "";
    if (!kind) return null;
    const value = this.points.geometry.getAttribute("value");
    value.array.set(this.values[kind].map((number) => (Number.isFinite(number) ? number : -1)));
    value.needsUpdate = true;
    const [smallest, high] = this.data.ranges[kind];
    const logarithmic = high > 5 * smallest;
    const low = logarithmic ? Math.max(smallest, high * 1e-3) : smallest;
    Object.assign(this.uniforms.low, { value: low });
    Object.assign(this.uniforms.high, { value: high > low ? high : low * (1 + 1e-6) });
    Object.assign(this.uniforms.logarithmic, { value: Number(logarithmic) });
    return { low, high, logarithmic };
  }

  /** Show a slice alone. @param axis 0 to 2, or -1 for everything @param part where along the axis, 0 to 1 */
  slice(axis, part) {
    this.uniforms.axis.value = axis;
    if (axis < 0) return null;
    const [low, high] = [this.box.low[axis], this.box.high[axis]];
    this.uniforms.middle.value = low + part * (high - low);
    this.uniforms.half_.value = 0.04 * (high - low);
    return this.uniforms.middle.value;
  }

  enlarge(factor) {
    this.ellipsoids.children.forEach((one, k) => {
      const [a, b, c] = this.data.half_axes[k].map((row) => row.map((entry) => factor * entry));
      const [x, y, z] = one.userData;
      one.matrix.set(...a, x, ...b, y, ...c, z, 0, 0, 0, 1);
      one.matrixWorldNeedsUpdate = true;
    });
  }
}

/** The controls of the map, and its part of the legend. */
class MapPanel {
  /** @param colours 256 x 4 bytes @param redraw draws the picture anew */
  constructor(map, colours, redraw) {
    Object.assign(this, { map, colours, redraw });
    this.on = (id) => document.getElementById(id);
    this.on("map-block").hidden = !map;
    if (!map) return;
    for (const id of ["map-kind", "map-axis"]) this.on(id).addEventListener("change", () => this.apply());
    this.on("map-slice").addEventListener("input", () => this.apply());
    this.on("show-ellipsoids").addEventListener("change", () => this.apply());
    factorSlider("ellipsoid-factor", FACTORS, map.data.factor, (factor) => {
      map.enlarge(factor);
      this.factor = factor;
      this.ellipsoidText();
      this.redraw();
    });
    this.on("map-kind").value = "std";
    this.apply();
  }

  apply() {
    const { map } = this;
    const kind = this.on("map-kind").value;
    const range = map.show(kind);
    const axis = Number(this.on("map-axis").value);
    const middle = map.slice(axis, Number(this.on("map-slice").value));
    this.on("map-slice-row").hidden = axis < 0 || !kind;
    this.on("map-axis").disabled = !kind;
    this.on("map-slice-text").textContent = middle === null ? "" : `${fixed(1e3 * middle, 0)} mm`;
    this.on("legend-map").hidden = !kind;
    if (range) {
      this.on("legend-map-title").textContent = MAP_TITLES[kind];
      drawBar(this.on("legend-map-bar"), this.colours);
      this.on("legend-map-ticks").replaceChildren(...tickMarks(1e3 * range.low, 1e3 * range.high, range.logarithmic));
    }
    map.ellipsoids.visible = this.on("show-ellipsoids").checked;
    this.ellipsoidText();
    this.redraw();
  }

  ellipsoidText() {
    this.on("legend-ellipsoids").textContent = this.map.ellipsoids.visible ? `Ellipsoids: 95 %, enlarged \u00d7${this.factor}` : "";
  }
}
