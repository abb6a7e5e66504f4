// Beams bent by a factor. Rotations are scaled, as rotation vectors, and what lies along a beam follows from them, so
// nothing is torn or stretched however large the factor. With the factor 1 a beam ends where it was simulated to end.
const STATIONS = 12;  // along a beam

const ONE = new THREE.Vector3(1, 1, 1);
const vector = ([x, y, z]) => new THREE.Vector3(x, y, z);
const moveBy = (p) => new THREE.Matrix4().makeTranslation(p.x, p.y, p.z);
const poseOf = ({ position, quaternion }) => new THREE.Matrix4().compose(position, quaternion, ONE);

// The rotation vector of a rotation, and the rotation of a vector.
function turnOf(matrix) {
  const q = new THREE.Quaternion().setFromRotationMatrix(matrix);
  if (q.w < 0) q.set(-q.x, -q.y, -q.z, -q.w);
  const axis = new THREE.Vector3(q.x, q.y, q.z), sine = axis.length();
  return sine > 0 ? axis.multiplyScalar(2 * Math.atan2(sine, q.w) / sine) : axis;
}

function turned(turn) {
  const angle = turn.length();
  const q = new THREE.Quaternion();
  return angle > 0 ? q.setFromAxisAngle(turn.clone().divideScalar(angle), angle) : q;
}

// The map that turns about a point and then moves it by `shift`.
function mapAt(point, shift, turn) {
  const q = turned(turn), moved = point.clone().applyQuaternion(q).negate().add(point).add(shift);
  return new THREE.Matrix4().compose(moved, q, ONE);
}

// Displacement and rotation of a point by a map.
const motionAt = (point, map) => ({ shift: point.clone().applyMatrix4(map).sub(point), turn: turnOf(map) });

// Maps of the cross-sections of a beam that is clamped at `from` and whose end `to` is moved by the map `tip`. The slopes
// of the clamped beam's cubic are its rotations; these times the factor lead along it. Where that misses the given end,
// by terms of second order, the rest is spread along the beam.
function bentBeam(from, to, tip, factor) {
  const along = to.clone().sub(from), length = along.length(), axis = along.clone().divideScalar(length);
  const { shift, turn } = motionAt(to, tip), twist = turn.dot(axis), slope = turn.clone().cross(along);
  const turnAt = (s) => {
    const bent = shift.clone().multiplyScalar(6 * s * (1 - s)).addScaledVector(slope, s * (3 * s - 2)).divideScalar(length);
    return axis.clone().cross(bent).addScaledVector(axis, twist * s);
  };
  const places = (by) => {
    const found = [from.clone()];
    for (let k = 0; k < STATIONS; k += 1) {
      const step = axis.clone().applyQuaternion(turned(turnAt((k + 0.5) / STATIONS).multiplyScalar(by)));
      found.push(found[k].clone().addScaledVector(step, length / STATIONS));
    }
    return found;
  };
  const rest = to.clone().add(shift).sub(places(1)[STATIONS]).multiplyScalar(Math.min(factor, 1));
  return places(factor).map((place, k) => {
    const s = k / STATIONS, centre = from.clone().addScaledVector(along, s);
    return mapAt(centre, place.addScaledVector(rest, s).sub(centre), turnAt(s).multiplyScalar(factor));
  });
}

// How far along a beam points (x, y, z, x, ...) are, in stations: in front of it 0, behind it all of them.
function stationsAlong(from, to, points) {
  const along = to.clone().sub(from), p = new THREE.Vector3();
  return Float32Array.from({ length: points.length / 3 }, (_, k) => {
    const share = p.fromArray(points, 3 * k).sub(from).dot(along) / along.lengthSq();
    return Math.min(Math.max(share, 0), 1) * STATIONS;
  });
}

// Points moved by the maps before and after their stations, into `out`.
function bendPoints(rest, stations, maps, out) {
  const each = maps.map(({ elements }) => elements);
  for (let k = 0; k < stations.length; k += 1) {
    const low = Math.min(Math.floor(stations[k]), each.length - 2), w = stations[k] - low, A = each[low], B = each[low + 1];
    const x = rest[3 * k], y = rest[3 * k + 1], z = rest[3 * k + 2];
    for (let i = 0; i < 3; i += 1) {
      const a = A[i] * x + A[4 + i] * y + A[8 + i] * z + A[12 + i], b = B[i] * x + B[4 + i] * y + B[8 + i] * z + B[12 + i];
      out[3 * k + i] = a + w * (b - a);
    }
  }
}

// A pole that carries the foot: one beam, which leads the foot, or two on either side of it, which follow it.
class Pole {
  constructor(beams) {
    this.beams = beams.map((ends) => ends.map(vector));
  }

  footOf(tip, factor) {
    return this.beams.length === 1 ? bentBeam(...this.beams[0], tip, factor).at(-1) : null;
  }

  mapsOf(foot, tip, factor) {
    return this.beams.length === 1 ? bentBeam(...this.beams[0], tip, factor) : this.beams.flatMap((beam) => bentBeam(...beam, foot, 1));
  }

  // Stations of both beams one after the other; a point is beside that beam from whose clamped end it is nearer.
  stationsOf(points) {
    const each = this.beams.map((beam) => stationsAlong(...beam, points));
    return each[0].map((station, k) => (each.length > 1 && station === STATIONS ? STATIONS + 1 + each[1][k] : station));
  }
}

// The guardrail's frame: its nodes are displaced and turned as linear theory has it for the motion of the feet. Every
// member has two stations, its ends.
class Frame {
  constructor({ nodes, shapes, feet, members }) {
    nodes = floats(nodes);
    this.nodes = Array.from({ length: nodes.length / 3 }, (_, k) => new THREE.Vector3().fromArray(nodes, 3 * k));
    Object.assign(this, { shapes: floats(shapes), feet: feet.map(vector), members });
  }

  footOf() {
    return null;
  }

  mapsOf(foot) {
    const moves = this.feet.flatMap((point) => Object.values(motionAt(point, foot)).flatMap((v) => v.toArray()));
    const width = moves.length;
    const maps = this.nodes.map((node, k) => {
      const moved = new Float64Array(6);
      for (let i = 0; i < 6 * width; i += 1) moved[Math.floor(i / width)] += this.shapes[6 * width * k + i] * moves[i % width];
      return mapAt(node, vector(moved.subarray(0, 3)), vector(moved.subarray(3)));
    });
    return this.members.flatMap(([a, b]) => [maps[a], maps[b]]);
  }

  stationsOf(points) {
    const p = new THREE.Vector3(), nearest = new THREE.Vector3();
    const lines = this.members.map(([a, b]) => new THREE.Line3(this.nodes[a], this.nodes[b]));
    return Float32Array.from({ length: points.length / 3 }, (_, k) => {
      p.fromArray(points, 3 * k);
      let best = null;
      lines.forEach((line, beam) => {
        const share = line.closestPointToPointParameter(p, true);
        const distance = line.at(share, nearest).distanceToSquared(p);
        if (!best || distance < best.distance) best = { station: 2 * beam + Math.min(share, 0.9999), distance };
      });
      return best.station;
    });
  }
}
