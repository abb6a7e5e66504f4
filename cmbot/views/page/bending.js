// The arm and what it stands on bent by their elastic coordinates times a factor: the chain of joints is followed anew,
// and links, pole and guardrail are bent along it as beams.
const matrixOf = ([x, y, z, ...turn]) => new THREE.Matrix4().compose(
  new THREE.Vector3(x, y, z), new THREE.Quaternion(...turn), ONE);

// The joints of one arm and what carries its foot.
class Chain {
  constructor(source) {
    this.joints = source.joints.map(({ pose, axis, driven, index }) => {
      const [linear, angular] = [vector(axis.slice(0, 3)), vector(axis.slice(3))];
      return { placement: matrixOf(pose), linear, angular, turns: angular.length() > 0.5, driven, index };
    });
    this.links = source.links.map(({ pose, tube, ...link }) => ({
      ...link, X: matrixOf(pose), tube: tube && [vector(tube.slice(0, 3)), vector(tube.slice(3))],
    }));
    this.base = source.base;
    this.foot = vector(source.foot);
    this.support = source.frame ? new Frame(source.frame) : source.pole.length ? new Pole(source.pole) : null;
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
    for (let k = 0; k <= this.base; k += 1) pose = this.after(pose, k, null, u, 1);
    return this.base < 0 ? pose : pose.multiply(moveBy(this.foot.clone().negate()));
  }

  footTimes(tip, factor) {
    const { shift, turn } = motionAt(this.foot, tip);
    return this.support?.footOf(tip, factor) ?? mapAt(this.foot, shift.multiplyScalar(factor), turn.multiplyScalar(factor));
  }

  // The bent arm: how W moves with the foot, and of every link the pose and the maps along its tube, or that of its end.
  follow(q, u, factor) {
    const tip = this.footMap(u), foot = this.footTimes(tip, factor);
    let pose = this.base < 0 ? foot : foot.clone().multiply(moveBy(this.foot)), next = this.base + 1;
    const links = this.links.map(({ start, end, X, tube }) => {
      for (; next <= start; next += 1) pose = this.after(pose, next, q, u, factor);
      const place = pose;
      let bent = new THREE.Matrix4();
      for (; next <= end; next += 1) bent = this.after(bent, next, q, u, 1);
      bent.multiply(X);
      const maps = tube ? bentBeam(...tube, bent, factor) : [bent, bent];
      pose = place.clone().multiply(maps.at(-1)).multiply(X.clone().invert());
      return { place, maps };
    });
    return { tip, foot, links };
  }
}

class Bending {
  // The motions have their own arms, or share the last of `chains`; an arm that does not bend has none.
  constructor(stage, { chains }) {
    Object.assign(this, { stage, factor: 0, drawn: {} });
    const made = chains.map((source) => source && new Chain(source));
    this.chains = Object.fromEntries(MOTIONS.map((name, k) => [name, made[Math.min(k, made.length - 1)]]));
    this.arms = Object.fromEntries(MOTIONS.map((name, k) => [name, stage.arms[name].map((node, i) => this.skins(name, node, i, k > 0))]));
    this.grounds = Object.fromEntries(MOTIONS.map((name) => [name, this.groundSkins(name)]));
  }

  // Meshes of a link that bends; a ghost gets shapes of its own.
  skins(name, node, link, own) {
    const tube = this.chains[name]?.links[link].tube;
    return tube ? skinsOf(node, (points) => stationsAlong(...tube, points), own) : [];
  }

  // Meshes of what carries an arm's foot.
  groundSkins(name) {
    const support = this.chains[name]?.support;
    if (!support) return [];
    return this.stage.grounds[name].flatMap(({ rails, shared }) => skinsOf(rails, (points) => support.stationsOf(points), shared));
  }

  // Put an arm where a motion has it; without a factor it is rigid, as it was placed before.
  place(name, motion, moment) {
    const { factor, stage: { arms } } = this, still = new THREE.Matrix4(), rigid = arms[name].map(poseOf);
    if (factor > 0 && motion.u) {
      const bent = this.chains[name].follow(motion.numbersAt(motion.q, moment), motion.numbersAt(motion.u, moment), factor);
      const none = new THREE.Vector3();
      bent.links.forEach(({ place }, i) => place.decompose(arms[name][i].position, arms[name][i].quaternion, none));
      this.drawn[name] = { ...bent, rigid, factor };
    } else {
      const links = rigid.map((place) => ({ place, maps: [still, still] }));
      this.drawn[name] = { tip: still, foot: still, links, rigid, factor: 0 };
    }
    this.shape(name, name);
    this.shapeGround(name, name);
  }

  // Where a point of the rigid arm is on the bent one; `joint` carries it: 0 the base, -1 nothing that moves, -2 what
  // the base stands on.
  carried(name, joint, point) {
    const { tip, foot, links, rigid, factor } = this.drawn[name], chain = this.chains[name];
    if (!factor || joint === -1) return point;
    const { support } = chain;
    if (joint === -2) return support ? bentPoint(point, (p) => support.stationsOf(p), support.mapsOf(foot, tip, factor)) : point;
    if (joint === 0) return point.applyMatrix4(foot);
    const { place, maps } = links[joint - 1], { tube } = chain.links[joint - 1];
    point.applyMatrix4(rigid[joint - 1].clone().invert());
    return (tube ? bentPoint(point, (p) => stationsAlong(...tube, p), maps) : point).applyMatrix4(place);
  }

  // Where a point at the tool of the rigid arm is on the bent one at a moment of a motion, the bending times a factor.
  toolAt(name, motion, moment, point, factor) {
    if (!motion.u) return point;
    const q = motion.numbersAt(motion.q, moment), u = motion.numbersAt(motion.u, moment);
    const [rigid, bent] = [0, factor].map((by) => {
      const { place, maps } = this.chains[name].follow(q, u, by).links.at(-1);
      return place.clone().multiply(maps.at(-1));
    });
    return point.applyMatrix4(rigid.invert()).applyMatrix4(bent);
  }

  // Give the shapes of one arm the bending of another's motion.
  shape(arm, name) {
    this.arms[arm].forEach((skins, link) => skins.forEach((skin) => bendSkin(skin, this.drawn[name].links[link].maps)));
  }

  // Give what carries one arm the bending of another's motion.
  shapeGround(arm, name) {
    const { tip, foot, factor } = this.drawn[name], none = new THREE.Vector3();
    for (const { base } of this.stage.grounds[arm]) foot.decompose(base.position, base.quaternion, none);
    if (!this.grounds[arm].length) return;
    const maps = this.chains[arm].support.mapsOf(foot, tip, factor);
    for (const skin of this.grounds[arm]) bendSkin(skin, maps);
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
