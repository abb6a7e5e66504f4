// The arm and the rails bent by their elastic coordinates times a factor: the chain of joints is followed anew, links
// are bent along their tubes as beams, rails as the frame of beams that bears the foot.
const STATIONS = 12;  // along a tube

const matrixOf = ([x, y, z, ...turn]) => new THREE.Matrix4().compose(
  new THREE.Vector3(x, y, z), new THREE.Quaternion(...turn), new THREE.Vector3(1, 1, 1));

class Bending {
  constructor(stage, source) {
    Object.assign(this, { stage, source, factor: 0 });
    this.joints = source.joints.map(({ pose, axis, driven, index }) => {
      const [linear, angular] = [new THREE.Vector3(...axis.slice(0, 3)), new THREE.Vector3(...axis.slice(3))];
      return { placement: matrixOf(pose), linear, angular, turns: angular.length() > 0.5, driven, index };
    });
    this.links = source.links.map((link) => ({ ...link, X: matrixOf(link.pose) }));
    this.base = stage.node("robot", "0");
    this.arms = Object.fromEntries(MOTIONS.map((name, k) => [name, stage.arms[name].map((node, i) => this.skin(node, i, k > 0))]));
    this.rails = source.frame ? this.railsOf(source.frame) : [];
    this.rigid = {};
    this.tips = {};
    this.foot = {};
  }

  // Meshes of a link that bends, with the station of each vertex; a ghost gets shapes of its own.
  skin(node, link, own) {
    const { tube } = this.links[link], meshes = [];
    if (!tube) return meshes;
    node.traverse((mesh) => {
      if (!mesh.geometry) return;
      if (own) mesh.geometry = mesh.geometry.clone();
      mesh.frustumCulled = false;
      const rest = mesh.geometry.attributes.position.array.slice();
      meshes.push({ mesh, rest, shares: sharesAlong(tube, rest) });
    });
    return meshes;
  }

  // Each vertex of the rails with the nearest beam, and how it moves with the foot: by that beam's displacement and
  // rotation.
  railsOf(frame) {
    const nodes = floats(frame.nodes), shapes = floats(frame.shapes), meshes = [];
    const node = (k) => new THREE.Vector3().fromArray(nodes, 3 * k);
    this.stage.node("rails").traverse((mesh) => {
      if (!mesh.geometry) return;
      mesh.frustumCulled = false;
      const rest = mesh.geometry.attributes.position.array.slice(), count = rest.length / 3;
      const moves = new Float32Array(18 * count), beams = new Int32Array(count), along = new Float32Array(count);
      for (let k = 0; k < count; k += 1) {
        const p = new THREE.Vector3().fromArray(rest, 3 * k);
        let best = null;
        for (const [beam, [a, b]] of frame.members.entries()) {
          const line = new THREE.Line3(node(a), node(b)), share = line.closestPointToPointParameter(p, true);
          const foot = line.at(share, new THREE.Vector3()), distance = foot.distanceToSquared(p);
          if (!best || distance < best.distance) best = { beam, a, b, share, foot, distance };
        }
        beams[k] = best.beam;
        along[k] = best.share;
        const offset = p.clone().sub(best.foot);
        for (let unit = 0; unit < 6; unit += 1) {
          const value = (n, row) => shapes[36 * n + 6 * row + unit];
          const mixed = [0, 1, 2, 3, 4, 5].map((row) => (1 - best.share) * value(best.a, row) + best.share * value(best.b, row));
          const turned = new THREE.Vector3(...mixed.slice(3)).cross(offset);
          moves.set([mixed[0] + turned.x, mixed[1] + turned.y, mixed[2] + turned.z], 18 * k + 3 * unit);
        }
      }
      meshes.push({ mesh, rest, moves, beams, along });
    });
    return meshes;
  }

  // Poses of the joints' frames in W.
  chain(q, u) {
    let last = new THREE.Matrix4();
    return this.joints.map(({ placement, linear, angular, turns, driven, index }) => {
      const value = driven ? q[index] : this.factor * u[index];
      const own = turns ? new THREE.Matrix4().makeRotationAxis(angular, value)
        : new THREE.Matrix4().makeTranslation(...linear.clone().multiplyScalar(value).toArray());
      last = last.clone().multiply(placement).multiply(own);
      return last;
    });
  }

  // Put an arm where a motion has it; without a factor it is rigid, as it was placed before.
  place(name, motion, moment) {
    const { links, factor } = this, bent = factor > 0 && motion.u;
    if (bent) {
      const q = motion.numbersAt(motion.q, moment), u = motion.numbersAt(motion.u, moment);
      const frames = this.chain(q, u), none = new THREE.Vector3();
      this.rigid[name] = this.stage.arms[name].map((node) => poseOf(node));
      this.tips[name] = links.map(({ start, end, X }, i) => {
        const begin = frames[start], tip = frames[end].clone().multiply(X);
        begin.decompose(this.stage.arms[name][i].position, this.stage.arms[name][i].quaternion, none);
        return begin.clone().invert().multiply(tip);
      });
      // At rest the base's frame is at O0, its shapes where they are in W.
      const back = new THREE.Matrix4().makeTranslation(...this.stage.data.foot.map((x) => -x));
      const base = frames[this.source.base];
      this.foot[name] = { pose: base ? base.clone().multiply(back) : new THREE.Matrix4(), u };
    } else {
      this.tips[name] = links.map(() => new THREE.Matrix4());
      this.foot[name] = { pose: new THREE.Matrix4(), u: null };
    }
    this.shape(name, name);
    if (name === MOTIONS[0]) this.shapeBase(name);
  }

  // Where a point of the rigid arm is on the bent one; `joint` carries it: 0 the base, -1 an obstacle.
  carried(name, joint, point) {
    const { u, pose } = this.foot[name];
    if (!u || joint < 0) return point;
    if (joint === 0) return point.applyMatrix4(pose);
    const link = joint - 1, { tube } = this.links[link], place = poseOf(this.stage.arms[name][link]);
    const local = point.applyMatrix4(this.rigid[name][link].clone().invert()), out = local.toArray();
    if (tube) bendPoints(local.toArray(), sharesAlong(tube, out), this.stations(tube, this.tips[name][link]), out);
    return point.fromArray(out).applyMatrix4(place);
  }

  // Give the shapes of one arm the bending of another's motion.
  shape(arm, name) {
    this.arms[arm].forEach((meshes, link) => {
      if (!meshes.length) return;
      const stations = this.stations(this.links[link].tube, this.tips[name][link]);
      for (const { mesh, rest, shares } of meshes) {
        const { position } = mesh.geometry.attributes;
        bendPoints(rest, shares, stations, position.array);
        position.needsUpdate = true;
      }
    });
  }

  shapeBase(name) {
    const { pose, u } = this.foot[name];
    pose.decompose(this.base.position, this.base.quaternion, new THREE.Vector3());
    for (const { mesh, rest, moves } of this.rails) {
      const { position } = mesh.geometry.attributes;
      for (let k = 0; k < rest.length; k += 1) {
        let value = rest[k];
        const vertex = Math.floor(k / 3), axis = k % 3;
        if (u) for (let unit = 0; unit < 6; unit += 1) value += this.factor * u[unit] * moves[18 * vertex + 3 * unit + axis];
        position.array[k] = value;
      }
      position.needsUpdate = true;
    }
  }

  // Maps (3 x 4) of cross-sections along a tube whose end is moved by `tip`: the cubic of a clamped beam.
  stations(tube, tip) {
    const from = new THREE.Vector3(...tube.slice(0, 3)), to = new THREE.Vector3(...tube.slice(3));
    const along = to.clone().sub(from), length = along.length(), axis = along.clone().divideScalar(length);
    const turn = new THREE.Quaternion().setFromRotationMatrix(tip);
    if (turn.w < 0) turn.set(-turn.x, -turn.y, -turn.z, -turn.w);
    const angle = 2 * Math.acos(Math.min(turn.w, 1)), rotation = new THREE.Vector3(turn.x, turn.y, turn.z);
    if (angle > 1e-9) rotation.setLength(angle);
    const shift = to.clone().applyMatrix4(tip).sub(to), twist = rotation.dot(axis);
    const slope = rotation.clone().cross(along);  // of the end, times the length
    const maps = [];
    for (let k = 0; k <= STATIONS; k += 1) {
      const s = k / STATIONS, h1 = s * s * (3 - 2 * s), h2 = s * s * (s - 1);
      const centre = along.clone().multiplyScalar(s).add(from);
      const moved = centre.clone().addScaledVector(shift, h1).addScaledVector(slope, h2);
      const bent = shift.clone().multiplyScalar(6 * s * (1 - s)).addScaledVector(slope, s * (3 * s - 2)).divideScalar(length);
      const turned = axis.clone().cross(bent).addScaledVector(axis, twist * s), by = turned.length();
      const R = new THREE.Matrix4();
      if (by > 1e-12) R.makeRotationAxis(turned.divideScalar(by), by);
      maps.push(new THREE.Matrix4().makeTranslation(...moved.toArray()).multiply(R)
        .multiply(new THREE.Matrix4().makeTranslation(...centre.negate().toArray())).elements);
    }
    // Behind the tube a link is as rigid as its end.
    maps[STATIONS] = tip.elements;
    return maps;
  }
}

const poseOf = ({ position, quaternion }) => new THREE.Matrix4().compose(position, quaternion, new THREE.Vector3(1, 1, 1));

// How far along a tube points (x, y, z, x, ...) are, in stations.
function sharesAlong(tube, points) {
  const from = new THREE.Vector3(...tube.slice(0, 3)), along = new THREE.Vector3(...tube.slice(3)).sub(from);
  return Float32Array.from({ length: points.length / 3 }, (_, k) => {
    const p = new THREE.Vector3().fromArray(points, 3 * k).sub(from);
    return Math.min(Math.max(p.dot(along) / along.lengthSq(), 0), 1) * STATIONS;
  });
}

// Points moved by the maps of the stations beside them, into `out`.
function bendPoints(rest, shares, maps, out) {
  for (let k = 0; k < shares.length; k += 1) {
    const low = Math.min(Math.floor(shares[k]), STATIONS - 1), w = shares[k] - low, A = maps[low], B = maps[low + 1];
    const x = rest[3 * k], y = rest[3 * k + 1], z = rest[3 * k + 2];
    for (let i = 0; i < 3; i += 1) {
      const a = A[i] * x + A[4 + i] * y + A[8 + i] * z + A[12 + i], b = B[i] * x + B[4 + i] * y + B[8 + i] * z + B[12 + i];
      out[3 * k + i] = a + w * (b - a);
    }
  }
}
