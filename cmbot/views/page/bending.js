// The arm and what it stands on bent by their elastic coordinates times a factor: the chain of joints is followed anew,
// and links, pole and guardrail are bent along it as beams.
const matrixOf = ([x, y, z, ...turn]) => new THREE.Matrix4().compose(
  new THREE.Vector3(x, y, z), new THREE.Quaternion(...turn), ONE);

class Bending {
  constructor(stage, source) {
    Object.assign(this, { stage, source, factor: 0, drawn: {} });
    this.joints = source.joints.map(({ pose, axis, driven, index }) => {
      const [linear, angular] = [vector(axis.slice(0, 3)), vector(axis.slice(3))];
      return { placement: matrixOf(pose), linear, angular, turns: angular.length() > 0.5, driven, index };
    });
    this.links = source.links.map(({ pose, tube, ...link }) => ({
      ...link, X: matrixOf(pose), tube: tube && [vector(tube.slice(0, 3)), vector(tube.slice(3))],
    }));
    this.base = stage.node("robot", "0");
    this.foot = vector(stage.data.foot);
    this.arms = Object.fromEntries(MOTIONS.map((name, k) => [name, stage.arms[name].map((node, i) => this.skins(node, i, k > 0))]));
    this.support = source.frame ? new Frame(source.frame) : source.pole.length ? new Pole(source.pole) : null;
    this.ground = this.support ? skinsOf(stage.node("rails"), (points) => this.support.stationsOf(points)) : [];
  }

  // Meshes of a link that bends; a ghost gets shapes of its own.
  skins(node, link, own) {
    const { tube } = this.links[link];
    return tube ? skinsOf(node, (points) => stationsAlong(...tube, points), own) : [];
  }

  // Pose of joint `k` behind a pose, its elastic coordinate times a factor.
  after(pose, k, q, u, factor) {
    const { placement, linear, angular, turns, driven, index } = this.joints[k], value = driven ? q[index] : factor * u[index];
    const own = turns ? new THREE.Matrix4().makeRotationAxis(angular, value) : moveBy(linear.clone().multiplyScalar(value));
    return pose.clone().multiply(placement).multiply(own);
  }

  // How W moves with the foot: as it was simulated, or by a factor.
  footMap(u) {
    let pose = new THREE.Matrix4();
    for (let k = 0; k <= this.source.base; k += 1) pose = this.after(pose, k, null, u, 1);
    return this.source.base < 0 ? pose : pose.multiply(moveBy(this.foot.clone().negate()));
  }

  footTimes(tip, factor) {
    const { shift, turn } = motionAt(this.foot, tip);
    return this.support?.footOf(tip, factor) ?? mapAt(this.foot, shift.multiplyScalar(factor), turn.multiplyScalar(factor));
  }

  // The bent arm: how W moves with the foot, and of every link the pose and the maps along its tube, or that of its end.
  follow(q, u, factor) {
    const tip = this.footMap(u), foot = this.footTimes(tip, factor);
    let pose = this.source.base < 0 ? foot : foot.clone().multiply(moveBy(this.foot)), next = this.source.base + 1;
    const links = this.links.map(({ start, end, X, tube }) => {
      for (; next <= start; next += 1) pose = this.after(pose, next, q, u, factor);
      const place = pose;
      let bent = new THREE.Matrix4();
      for (; next <= end; next += 1) bent = this.after(bent, next, q, u, 1);
      bent.multiply(X);
      const maps = tube ? bentBeam(...tube, bent, factor) : [bent];
      pose = place.clone().multiply(maps.at(-1)).multiply(X.clone().invert());
      return { place, maps };
    });
    return { tip, foot, links };
  }

  // Put an arm where a motion has it; without a factor it is rigid, as it was placed before.
  place(name, motion, moment) {
    const { factor, stage: { arms } } = this, still = new THREE.Matrix4(), rigid = arms[name].map(poseOf);
    if (factor > 0 && motion.u) {
      const bent = this.follow(motion.numbersAt(motion.q, moment), motion.numbersAt(motion.u, moment), factor), none = new THREE.Vector3();
      bent.links.forEach(({ place }, i) => place.decompose(arms[name][i].position, arms[name][i].quaternion, none));
      this.drawn[name] = { ...bent, rigid, factor };
    } else {
      const links = rigid.map((place) => ({ place, maps: [still, still] }));
      this.drawn[name] = { tip: still, foot: still, links, rigid, factor: 0 };
    }
    this.shape(name, name);
    if (name === MOTIONS[0]) this.shapeBase(name);
  }

  // Where a point of the rigid arm is on the bent one; `joint` carries it: 0 the base, -1 nothing that moves, -2 what
  // the base stands on.
  carried(name, joint, point) {
    const { tip, foot, links, rigid, factor } = this.drawn[name];
    if (!factor || joint === -1) return point;
    if (joint === -2) return this.support ? bentPoint(point, (p) => this.support.stationsOf(p), this.support.mapsOf(foot, tip, factor)) : point;
    if (joint === 0) return point.applyMatrix4(foot);
    const { place, maps } = links[joint - 1], { tube } = this.links[joint - 1];
    point.applyMatrix4(rigid[joint - 1].clone().invert());
    return (tube ? bentPoint(point, (p) => stationsAlong(...tube, p), maps) : point).applyMatrix4(place);
  }

  // Where a point at the tool of the rigid arm is on the bent one at a moment of a motion, the bending times a factor.
  toolAt(motion, moment, point, factor) {
    const q = motion.numbersAt(motion.q, moment), u = motion.numbersAt(motion.u, moment), last = this.links.length - 1;
    const [rigid, bent] = [0, factor].map((by) => {
      const { place, maps } = this.follow(q, u, by).links[last];
      return place.clone().multiply(maps.at(-1));
    });
    return point.applyMatrix4(rigid.invert()).applyMatrix4(bent);
  }

  // Give the shapes of one arm the bending of another's motion.
  shape(arm, name) {
    this.arms[arm].forEach((skins, link) => skins.forEach((skin) => bendSkin(skin, this.drawn[name].links[link].maps)));
  }

  shapeBase(name) {
    const { tip, foot, factor } = this.drawn[name];
    foot.decompose(this.base.position, this.base.quaternion, new THREE.Vector3());
    if (!this.support) return;
    const maps = this.support.mapsOf(foot, tip, factor);
    for (const skin of this.ground) bendSkin(skin, maps);
  }
}

// The meshes below a node with their vertices at rest, and the stations of these along beams.
function skinsOf(node, stationsOf, own = false) {
  const skins = [];
  node.traverse((mesh) => {
    if (!mesh.geometry) return;
    if (own) mesh.geometry = mesh.geometry.clone();
    mesh.frustumCulled = false;
    const rest = mesh.geometry.attributes.position.array.slice();
    skins.push({ mesh, rest, stations: stationsOf(rest) });
  });
  return skins;
}

function bendSkin({ mesh, rest, stations }, maps) {
  const { position } = mesh.geometry.attributes;
  bendPoints(rest, stations, maps, position.array);
  position.needsUpdate = true;
}

function bentPoint(point, stationsOf, maps) {
  const rest = Float32Array.from(point.toArray()), out = new Float32Array(3);
  bendPoints(rest, stationsOf(rest), maps, out);
  return point.fromArray(out);
}
