"use strict";
// The 3-D picture: meshcat's viewer, the arm and its ghost, the torque arrow, the light and the camera.
const { THREE } = MeshCat;

const floats = (text) => {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
};
const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

class Stage {
  constructor(data) {
    this.data = data;
    this.viewer = new MeshCat.Viewer(document.getElementById("view"));
    this.viewer.gui.domElement.remove();
    for (const command of data.commands) this.viewer.handle_command_bytearray(bytesOf(command));
    this.arms = { planned: data.links.map((_, i) => this.node("robot", String(i + 1))) };
    this.arms.baseline = this.addGhost();
    this.arrow = this.addArrow();
    this.addLight();
    this.resetView();
  }

  node(...path) {
    return this.viewer.scene_tree.find(path).object;
  }

  get world() {
    return this.viewer.scene;
  }

  redraw() {
    this.viewer.set_dirty();
  }

  // The baseline's arm shares the planned arm's shapes. It is drawn twice, first into the depth buffer only, so
  // that no shape shows through another; a little behind, so that it vanishes where both arms are the same.
  addGhost() {
    const behind = { polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 4 };
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, ...behind });
    const tint = new THREE.MeshLambertMaterial({
      color: 0x2f6fb7, transparent: true, opacity: 0.4, depthWrite: false, ...behind });
    this.ghost = new THREE.Group();
    this.world.add(this.ghost);
    return this.arms.planned.map((link) => {
      const twin = new THREE.Group();
      for (const [order, material] of [[1, depth], [2, tint]]) {
        const copy = link.clone(true);
        copy.traverse((part) => {
          part.renderOrder = order;
          part.castShadow = part.receiveShadow = false;
          if (part.material) part.material = material;
        });
        twin.add(copy);
      }
      this.ghost.add(twin);
      return twin;
    });
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

  showTorque(vector, share) {
    const { group, shaft, heads, thick, material, tip } = this.arrow;
    const length = Math.max(0.32 * share * this.data.reach, 10 * thick);
    const direction = vector.clone().normalize();
    group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), direction);
    shaft.scale.set(1, 1, length - 5 * thick);
    heads[0].position.z = length - 2.5 * thick;
    heads[1].position.z = length - 6.5 * thick;
    material.color.setHSL(0.13 * Math.pow(1 - Math.min(share, 1), 0.6), 0.95, 0.47);
    tip.copy(direction).multiplyScalar(length);
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
    sun.shadow.mapSize.set(2048, 2048);
    Object.assign(sun.shadow.camera, { left: -size, right: size, top: size, bottom: -size, near: 0.1, far: 8 * radius });
    sun.shadow.normalBias = 0.01 * radius;
    sun.shadow.radius = 3;
  }

  // The ball of interest in the middle of the part of the window that the bar below leaves free.
  resetView() {
    const { centre, radius, azimuth } = this.data.focus;
    const { camera, controls } = this.viewer;
    const width = window.innerWidth, height = window.innerHeight;
    const free = Math.max(document.getElementById("bar").getBoundingClientRect().top, 0.3 * height);
    camera.fov = 36;
    const metresPerPixel = (2 * 1.05 * radius) / Math.min(free, width);
    const distance = (metresPerPixel * height) / (2 * Math.tan((camera.fov * Math.PI) / 360));
    const toCamera = (x, y, z) => new THREE.Vector3(x, z, -y);  // the camera's up is y
    const target = toCamera(...centre).add(new THREE.Vector3(0, -0.5 * (height - free) * metresPerPixel, 0));
    const outward = toCamera(Math.cos(azimuth), Math.sin(azimuth), 0.24).setLength(distance);
    controls.target.copy(target);
    camera.near = 0.01 * distance;
    camera.far = 100 * distance;
    camera.position.copy(target).add(outward);
    controls.update();
    this.redraw();
  }

  afterRender(action) {
    this.world.onAfterRender = action;
  }

  // Where a point of W is on the screen, px.
  onScreen(point) {
    const p = this.world.localToWorld(point.clone()).project(this.viewer.camera);
    return [(0.5 + 0.5 * p.x) * window.innerWidth, (0.5 - 0.5 * p.y) * window.innerHeight];
  }

  // Pose of a link in W as it is drawn now, 4 x 4, row after row.
  pose(arm, index) {
    this.world.updateMatrixWorld(true);
    const inWorld = this.world.matrixWorld.clone().invert().multiply(this.arms[arm][index].matrixWorld);
    return inWorld.transpose().toArray();
  }
}
