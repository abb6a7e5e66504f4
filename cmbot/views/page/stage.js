"use strict";
// The 3-D view: meshcat's viewer, the arm and the baseline's ghost, the torque arrow, the light and the camera.
const { THREE } = MeshCat;

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const floats = (text) => new Float32Array(bytesOf(text).buffer);
const degrees = (angle) => (angle * 180) / Math.PI;
// Names of the motions, that which is drawn whole first; a page of several plans has others.
const MOTIONS = ["planned", "baseline"];
const COLOURS = { planned: 0xe0560f, baseline: 0x2f6fb7, near: 0xb8860b, tooNear: 0xd00000,
  plan_2: 0x2f6fb7, plan_3: 0x18794e, plan_4: 0x7b2cbf, plan_5: 0xb28600, plan_6: 0x00838f };
const HALF_ANGLE = Math.tan(Math.PI / 10);  // tangent of half the fitted field of view

// The size of a part of the view without what is covered.
const clearOf = ({ wide, high, above, below, edge }) => ({ wide: wide - edge, high: high - above - below });

// Draw the backs of triangles a little farther away: along the outline of a round part a triangle's back is as near as
// another's front, and its dark dots would be seen there. Fronts and backs share their shapes.
function partSides(node) {
  const meshes = [];
  node.traverse((mesh) => { if (mesh.material?.side === THREE.DoubleSide) meshes.push(mesh); });
  for (const mesh of meshes) {
    const back = mesh.clone();
    back.material = mesh.material.clone();
    Object.assign(back.material, { side: THREE.BackSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 20 });
    Object.assign(mesh.material, { side: THREE.FrontSide, shadowSide: THREE.DoubleSide });
    back.castShadow = false;
    mesh.parent.add(back);
  }
}

class Stage {
  constructor(data) {
    this.data = data;
    this.view = document.getElementById("view");
    this.viewer = new MeshCat.Viewer(this.view);
    this.viewer.gui.domElement.remove();
    for (const command of data.commands) this.viewer.handle_command_bytearray(bytesOf(command));
    const [first, ...others] = MOTIONS;
    this.arms = { [first]: data.links.map((_, i) => this.node("robot", String(i + 1))) };
    // What carries each arm: its base and what that stands on.
    this.grounds = { [first]: [{ base: this.node("robot", "0"), rails: this.node("rails"), shared: false }] };
    this.ghosts = others.map((name) => this.addGhost(name));
    this.arrow = this.addArrow();
    this.torque = Object.fromEntries(MOTIONS.map((name) => [name, new THREE.Vector3()]));
    this.marks = new Marks(this, data);
    this.bending = data.bending && new Bending(this, data.bending);
    for (const path of [["robot"], ["rails"], ...this.owners.map((name) => ["others", name])]) partSides(this.node(...path));
    this.colours = new Colours(this, data);
    this.compare = "ghost";
    this.withArrow = true;
    this.addLight();
    this.fit();
    this.dress();
    this.resetView();
  }

  // meshcat fills the window; here it fills its own element, and draws one picture or two.
  fit() {
    const { viewer, view } = this, resize = viewer.set_3d_pane_size;
    viewer.set_3d_pane_size = () => resize.call(viewer, view.clientWidth || 1, view.clientHeight || 1);
    viewer.render = () => this.render();
    new ResizeObserver(() => {
      viewer.set_3d_pane_size();
      this.refit();
    }).observe(view);
    // A view that nobody has turned yet is fitted to its size again.
    viewer.controls.addEventListener("start", () => { this.turned = true; });
    viewer.controls.addEventListener("end", () => this.onTurned?.());
    viewer.set_3d_pane_size();
  }

  // Take another size, px, and keep the scale of the shorter side. Returns a function that restores the size.
  borrowSize(wide, high) {
    const { style } = this.view, { width, height } = style, { fitted } = this;
    const shorter = () => Math.min(this.parts[0].wide, this.parts[0].high), before = shorter();
    Object.assign(style, { width: `${wide}px`, height: `${high}px` });
    this.fitted *= shorter() / before;
    this.viewer.set_3d_pane_size();
    return () => {
      Object.assign(style, { width, height });
      this.fitted = fitted;
      this.viewer.set_3d_pane_size();
    };
  }

  // Background for the light or the dark page.
  dress() {
    const dark = window.matchMedia("(prefers-color-scheme: dark)");
    const colour = () => {
      const [top, bottom] = dark.matches ? [[0.42, 0.46, 0.51], [0.2, 0.23, 0.27]] : [[0.98, 0.985, 0.99], [0.72, 0.78, 0.84]];
      this.viewer.set_property(["Background"], "top_color", top);
      this.viewer.set_property(["Background"], "bottom_color", bottom);
      this.viewer.show_background();
      // Paths are dark: before a dark background they glow.
      const above = [[], ...MOTIONS.slice(1).map((name) => ["others", name])];
      for (const path of above.flatMap((names) => [[...names, "path"], [...names, "left_out"]])) {
        this.node(...path).traverse((mesh) => mesh.material?.emissive?.copy(mesh.material.color).multiplyScalar(dark.matches ? 0.6 : 0));
      }
      this.redraw();
    };
    dark.addEventListener("change", colour);
    colour();
  }

  node(...path) {
    return this.viewer.scene_tree.find(path).object;
  }

  get world() {
    return this.viewer.scene;
  }

  get beside() {
    return this.compare === "beside";
  }

  redraw() {
    this.viewer.set_dirty();
  }

  setCompare(how) {
    const before = this.beside;
    this.compare = how;
    if (this.beside !== before) this.resetView();
    this.redraw();
  }

  // The parts of the view and the motion in each: they divide its longer side. Card and bar cover some of a part:
  // `above` and `below` it or to its left (`edge`), px; rows are equally high without that.
  get parts() {
    const [wide, high] = [this.view.clientWidth || 1, this.view.clientHeight || 1], [above, below, edge] = this.covered(high);
    const whole = { motion: MOTIONS[0], left: 0, top: 0, wide, high, above, below, edge };
    if (!this.beside) return [whole];
    const count = MOTIONS.length, last = count - 1, share = (side, k) => Math.floor((side * k) / count);
    if (wide > high) {
      return MOTIONS.map((motion, k) => ({ ...whole, motion, left: share(wide, k), wide: share(wide, k + 1) - share(wide, k) }));
    }
    const begin = (k) => (k === 0 ? 0 : k === count ? high : above + share(high - above - below, k));
    return MOTIONS.map((motion, k) => ({ ...whole, motion, top: begin(k), high: begin(k + 1) - begin(k),
      above: k === 0 ? above : 0, below: k === last ? below : 0 }));
  }

  render() {
    const { viewer, view, parts } = this, { renderer, camera } = viewer;
    viewer.controls.update();
    renderer.setScissorTest(parts.length > 1);
    for (const part of parts) {
      const box = [part.left, view.clientHeight - part.top - part.high, part.wide, part.high];
      renderer.setViewport(...box);
      renderer.setScissor(...box);
      // A view that has grown since shows more, not larger. Its middle is that of what nothing covers.
      const clear = clearOf(part);
      camera.fov = degrees(2 * Math.atan(HALF_ANGLE * (clear.high / this.fitted)));
      camera.setViewOffset(clear.wide, clear.high, -part.edge, -part.above, part.wide, part.high);
      this.posed(part.motion, () => renderer.render(viewer.scene, camera));
      this.onDrawn?.(part);
    }
    viewer.needs_render = false;
  }

  // Draw with the arm in the pose of one motion. The picture of another one uses the first arm's shapes.
  posed(motion, draw) {
    const whole = this.arms[MOTIONS[0]], own = this.arms[motion];
    const borrowed = own === whole ? [] : whole.map((link) => [link.position.clone(), link.quaternion.clone()]);
    borrowed.forEach((_, i) => {
      whole[i].position.copy(own[i].position);
      whole[i].quaternion.copy(own[i].quaternion);
    });
    if (borrowed.length) this.dressAs(motion);
    for (const ghost of this.ghosts) ghost.visible = this.compare === "ghost";
    this.showGround(motion);
    this.marks.show(motion, this.compare);
    this.arrow.group.visible = this.withArrow;
    this.drawTorque(this.torque[motion], motion);
    draw();
    if (borrowed.length) this.dressAs(MOTIONS[0]);
    borrowed.forEach(([position, quaternion], i) => {
      whole[i].position.copy(position);
      whole[i].quaternion.copy(quaternion);
    });
  }

  // Give the first arm's shapes and what carries them the bending and the colours of one motion.
  dressAs(motion) {
    this.bending?.shape(MOTIONS[0], motion);
    if (!this.owners.includes(motion)) this.bending?.shapeGround(MOTIONS[0], motion);
    this.colours.paint(motion);
  }

  // The motions of other plans whose arms stand elsewhere, or on something else: they have a base and supports of their own.
  get owners() {
    return this.data.owners ?? [];
  }

  // Show what carries the arm of one motion.
  showGround(motion) {
    const own = this.owners.includes(motion) ? motion : MOTIONS[0];
    for (const name of [MOTIONS[0], ...this.owners]) {
      const { base, rails } = this.grounds[name].at(-1);
      base.visible = rails.visible = name === own;
    }
  }

  // A ghost shares the first arm's shapes, and stands on a ghost of what carries it. It is drawn twice, first into the depth
  // buffer only, so that no shape shows through another; with an offset in depth, some thousandths of the distance, so that
  // it vanishes where both arms nearly coincide.
  addGhost(name) {
    const behind = { polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 600 };
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, ...behind });
    const tint = new THREE.MeshLambertMaterial({
      color: COLOURS[name], transparent: true, opacity: 0.4, depthWrite: false, ...behind });
    const ghost = new THREE.Group(), own = this.owners.includes(name);
    this.world.add(ghost);
    const twinOf = (node) => {
      const twin = new THREE.Group();
      for (const [order, material] of [[1, depth], [2, tint]]) {
        const copy = node.clone(true);
        copy.traverse((part) => {
          part.renderOrder = order;
          part.castShadow = part.receiveShadow = false;
          if (part.material) part.material = material;
        });
        twin.add(copy);
      }
      ghost.add(twin);
      return twin;
    };
    this.arms[name] = this.arms[MOTIONS[0]].map(twinOf);
    const [base, rails] = own ? ["base", "rails"].map((part) => this.node("others", name, part))
      : [this.node("robot", "0"), this.node("rails")];
    this.grounds[name] = [{ base: twinOf(base), rails: twinOf(rails), shared: true }];
    if (own) this.grounds[name].push({ base, rails, shared: false });
    return ghost;
  }

  // A torque is drawn as an arrow with two heads along its axis, from the foot.
  addArrow() {
    const thick = 0.011 * this.data.reach;
    const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.95, depthTest: false });
    const part = (geometry) => {
      const mesh = new THREE.Mesh(geometry.rotateX(Math.PI / 2), material);
      mesh.renderOrder = 3;
      return mesh;
    };
    const shaft = part(new THREE.CylinderGeometry(0.5 * thick, 0.5 * thick, 1, 20).translate(0, 0.5, 0));
    const heads = [0, 1].map(() => part(new THREE.ConeGeometry(1.5 * thick, 5 * thick, 24)));
    const group = new THREE.Group();
    group.add(shaft, ...heads);
    this.world.add(group);
    return { group, shaft, heads, thick, material, tip: new THREE.Vector3() };
  }

  // Length and redness grow with the share of the largest torque of both motions.
  drawTorque(vector, motion) {
    const { group, shaft, heads, thick, material, tip } = this.arrow;
    const share = vector.length() / this.peak;
    const length = Math.max(share * this.data.arrow, 10 * thick);
    const direction = vector.clone().normalize();
    group.position.set(...(this.data.feet?.[motion] ?? this.data.foot));
    this.bending?.carried(motion, 0, group.position);
    group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), direction);
    shaft.scale.set(1, 1, length - 5 * thick);
    heads[0].position.z = length - 2.5 * thick;
    heads[1].position.z = length - 6.5 * thick;
    material.color.setHSL(0.13 * Math.pow(1 - Math.min(share, 1), 0.6), 0.95, 0.47);
    tip.copy(direction).multiplyScalar(length).add(group.position);
  }

  addLight() {
    const { centre, radius } = this.data.focus;
    const light = (kind, position) => {
      kind.position.set(...position.map((value, i) => centre[i] + 3 * radius * value));
      kind.target?.position.set(...centre);
      this.world.add(kind, ...(kind.target ? [kind.target] : []));
      return kind;
    };
    const sky = new THREE.HemisphereLight(0xffffff, 0x9aa4ae, 0.62);
    sky.position.set(0, 0, 1);
    this.world.add(sky);
    light(new THREE.DirectionalLight(0xdde8ff, 0.22), [-0.9, 0.5, -0.2]);
    const sun = light(new THREE.DirectionalLight(0xfff6e8, 0.55), [0.35, 0.75, 0.8]);
    const size = 1.8 * radius;
    sun.castShadow = true;
    // Where the page is drawn smaller, so are shadows.
    sun.shadow.mapSize.setScalar(2048 * Math.min(window.devicePixelRatio || 1, 1));
    Object.assign(sun.shadow.camera, { left: -size, right: size, top: size, bottom: -size, near: 0.1, far: 8 * radius });
    sun.shadow.normalBias = 0.01 * radius;
    sun.shadow.radius = 3;
  }

  // Show arm and path as large as fits into what nothing covers of the first part of the view: below or beside the card.
  resetView() {
    const { radius, azimuth, rise } = this.data.focus, { camera, controls } = this.viewer;
    const toCamera = ([x, y, z]) => new THREE.Vector3(x, z, -y);  // the camera's up is y
    const outward = toCamera([Math.cos(azimuth), Math.sin(azimuth), rise]).normalize();
    const right = new THREE.Vector3(0, 1, 0).cross(outward).normalize(), up = outward.clone().cross(right);
    const places = this.data.focus.points.map(toCamera).map((p) => [p.dot(right), p.dot(up), p.dot(outward)]);
    const views = [true, false].map((below) => {
      this.belowCard = below;
      return { below, ...this.viewOf(places, clearOf(this.parts[0])) };
    });
    const best = views[0].scale >= views[1].scale ? views[0] : views[1];
    this.belowCard = best.below;
    this.fitted = clearOf(this.parts[0]).high;
    const near = Math.max(...places.map(([, , z]) => z)) - radius;  // the middle of the depth is what the view turns about
    controls.target.copy(right).multiplyScalar(best.across).addScaledVector(up, best.height).addScaledVector(outward, near);
    camera.near = 0.01 * best.distance;
    camera.far = 100 * best.distance;
    camera.position.copy(controls.target).addScaledVector(outward, best.distance - near);
    controls.update();
    this.turned = false;
    this.onTurned?.();
    this.redraw();
  }

  // Where a camera shows `places` (right, up, towards it) as large as fits into an area, px.
  viewOf(places, { wide, high }) {
    // A point is seen where |x - X| <= (D - z) s: of all points the outermost give the least distance D.
    const most = (value) => Math.max(...places.map(value)) + 0.03 * this.data.reach;
    const side = (HALF_ANGLE * wide) / high, half = HALF_ANGLE;
    const [east, west] = [most(([x, , z]) => x + side * z), most(([x, , z]) => side * z - x)];
    const [north, south] = [most(([, y, z]) => y + half * z), most(([, y, z]) => half * z - y)];
    const distance = Math.max((east + west) / (2 * side), (north + south) / (2 * half));
    return { distance, across: (east - west) / 2, height: (north - south) / 2, scale: high / distance };
  }

  // Where the camera is, and what it looks at, in the viewer's coordinates.
  get place() {
    const { camera, controls } = this.viewer;
    return [...camera.position.toArray(), ...controls.target.toArray()];
  }

  look(values) {
    const { camera, controls } = this.viewer;
    this.turned = true;
    camera.position.fromArray(values);
    controls.target.fromArray(values, 3);
    controls.update();
    this.redraw();
  }

  // Hide or show what is drawn for orientation only.
  toggleAround() {
    const around = this.node("around");
    around.visible = !around.visible;
    this.redraw();
  }

  // Fit a view that nobody has turned to what covers it now.
  refit() {
    if (!this.turned) this.resetView();
    this.redraw();
  }

  // How much of a view that fills the window card, bar and a film's note cover, px: from above, from below and, where the view is not
  // below the card but beside it, from the left. Columns have one camera, and are below it.
  covered(high) {
    if (getComputedStyle(this.view).position !== "fixed") return [0, 0, 0];
    const box = this.view.getBoundingClientRect();
    const [card, bar, note] = ["card", "bar", "magnified"].map((id) => document.getElementById(id)?.getBoundingClientRect());
    const below = Math.max(...[bar, note].map((part) => (part?.height > 0 ? box.bottom - part.top : 0)), 0);
    if (card && !this.belowCard && !this.beside) return [0, below, Math.min(card.right - box.left, 0.9 * box.width)];
    const above = card ? Math.max(card.bottom - box.top, 0) : 0;
    const share = Math.min(1, (0.7 * high) / Math.max(above + below, 1));
    return [share * above, share * below, 0];
  }

  // Turn the camera about its target, rad, or move it there by a factor of the distance, or both aside, in shares of it.
  turn(azimuth, elevation) {
    this.turned = true;
    const { camera, controls } = this.viewer;
    const at = new THREE.Spherical().setFromVector3(camera.position.clone().sub(controls.target));
    at.theta += azimuth;
    at.phi = Math.min(Math.max(at.phi + elevation, 0.02), Math.PI - 0.02);
    camera.position.copy(controls.target).add(new THREE.Vector3().setFromSpherical(at));
    controls.update();
    this.redraw();
    this.onTurned?.();
  }

  approach(factor) {
    this.turned = true;
    const { camera, controls } = this.viewer;
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    this.redraw();
    this.onTurned?.();
  }

  shift(right, up) {
    this.turned = true;
    const { camera, controls } = this.viewer, distance = camera.position.distanceTo(controls.target);
    const by = new THREE.Vector3(right * distance, up * distance, 0).applyQuaternion(camera.quaternion);
    camera.position.add(by);
    controls.target.add(by);
    controls.update();
    this.redraw();
    this.onTurned?.();
  }

  // On a page longer than the window the wheel scrolls; with Ctrl it zooms the view.
  scrollWithWheel() {
    const { controls } = this.viewer;
    this.view.addEventListener("wheel", (event) => { controls.enableZoom = event.ctrlKey; }, { capture: true });
  }

  // Where a point of W is in a part of the view, px.
  onScreen(point, { left, top, wide, high }) {
    const p = this.world.localToWorld(point.clone()).project(this.viewer.camera);
    return [left + (0.5 + 0.5 * p.x) * wide, top + (0.5 - 0.5 * p.y) * high];
  }

  // For a film: pictures are drawn on demand only, not by the viewer's own loop. Without a graphics card each pixel is
  // dear: light is computed at vertices, and edges of shadows are sharp.
  holdStill() {
    this.resetView();
    this.viewer.renderer.shadowMap.type = THREE.BasicShadowMap;
    this.world.traverse((part) => {
      if (!part.material?.isMeshPhongMaterial) return;
      const { color, side, transparent, opacity, polygonOffset, polygonOffsetFactor, polygonOffsetUnits } = part.material;
      const offset = { polygonOffset, polygonOffsetFactor, polygonOffsetUnits };
      part.material = new THREE.MeshLambertMaterial({ color, side, transparent, opacity, ...offset });
    });
    this.viewer.needs_render = false;
    this.viewer.set_dirty = () => {};
  }

  // The picture as it is now, as the address of a PNG.
  still() {
    return this.viewer.capture_image();
  }

  // Pose of a link in W as it is drawn now, 4 x 4, row after row.
  pose(arm, index) {
    this.world.updateMatrixWorld(true);
    const inWorld = this.world.matrixWorld.clone().invert().multiply(this.arms[arm][index].matrixWorld);
    return inWorld.transpose().toArray();
  }
}
