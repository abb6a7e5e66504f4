// The motions as functions of time, in phases: the approach if there is one, the work, and after it the return or,
// if that was simulated, the rest, in which elastic parts vibrate.
class Motion {
  constructor(source, links) {
    this.links = links;
    for (const name of ["poses", "torque", "clearance", "near", "pair", "tool", "q", "load"]) this[name] = floats(source[name]);
    this.u = source.u === null ? null : floats(source.u);
    this.hold = source.hold === null ? null : floats(source.hold);
    this.error = source.error === null ? null : floats(source.error);
    this.expected = source.expected ?? false;
    this.still = source.still ?? false;
    this.peakTorque = source.peakTorque;
    this.minClearance = source.minClearance;
    this.norms = this.clearance.map((_, k) => Math.hypot(...this.torque.subarray(3 * k, 3 * k + 3)));
  }

  // The frame before a share of the motion's time, and the share of the way from it to the next.
  between(share) {
    const at = share * (this.norms.length - 1), frame = Math.min(Math.floor(at), this.norms.length - 2);
    return [frame, at - frame];
  }

  place(link, index, moment) {
    const [frame, share] = this.between(moment);
    const p = [new THREE.Vector3(), new THREE.Vector3()], r = [new THREE.Quaternion(), new THREE.Quaternion()];
    for (const k of [0, 1]) {
      const start = 7 * ((frame + k) * this.links + index);
      p[k].fromArray(this.poses, start);
      r[k].fromArray(this.poses, start + 3);
    }
    link.position.lerpVectors(p[0], p[1], share);
    link.quaternion.copy(r[0].slerp(r[1], share));
  }

  // Interpolated vector of values with three numbers a frame.
  vectorAt(values, moment) {
    return new THREE.Vector3().fromArray(this.numbersAt(values, moment));
  }

  // Interpolated numbers of a frame.
  numbersAt(values, moment) {
    const [frame, share] = this.between(moment), width = values.length / this.norms.length, start = frame * width;
    return Float64Array.from({ length: width }, (_, i) => (1 - share) * values[start + i] + share * values[start + width + i]);
  }

  torqueAt(moment) {
    return this.vectorAt(this.torque, moment);
  }

  clearanceAt(moment) {
    const [frame, share] = this.between(moment);
    return share ? (1 - share) * this.clearance[frame] + share * this.clearance[frame + 1] : this.clearance[frame];
  }

  // Nearest points and their distance. Between frames with different pairs they are not interpolated.
  nearAt(moment) {
    const [frame, share] = this.between(moment);
    const nearest = share < 0.5 ? frame : frame + 1, pair = this.pair[nearest];
    if (pair < 0) return null;
    const at = this.pair[frame] === this.pair[frame + 1] ? moment : nearest / (this.norms.length - 1);
    const near = this.numbersAt(this.near, at);
    const [point, other] = [0, 3].map((first) => new THREE.Vector3().fromArray(near, first));
    return { point, other, pair, distance: near[6] };
  }

  toolAt(moment) {
    return this.vectorAt(this.tool, moment);
  }

  errorAt(moment) {
    return this.error && this.vectorAt(this.error, moment);
  }
}

// What a motion is called.
const NAMES = {};
function nameMotions({ motions, names }) {
  if (!motions) return;
  MOTIONS.splice(0, MOTIONS.length, ...motions);
  Object.assign(NAMES, names);
  document.getElementById("others").textContent = "Other plans";
}
const motionName = (motion) => NAMES[motion] ?? motion;

// A part of the timeline in which each arm has one motion.
class Phase {
  // `free`: the name of a free move, with the tool off.
  constructor(start, end, source, links, free = "") {
    Object.assign(this, { start, end, free, label: source.label ?? "" });
    this.motions = Object.fromEntries(MOTIONS.map((name) => [name, new Motion(source[name], links)]));
    this.peak = Math.max(...MOTIONS.map((name) => source[name].peakTorque));
    this.strain = Math.max(...MOTIONS.map((name) => source[name].strain));
  }

  share(time) {
    return (time - this.start) / (this.end - this.start);
  }

  timeOf(share) {
    return this.start + share * (this.end - this.start);
  }
}

function phasesOf(data) {
  const links = data.links.length, { start, workStart, workEnd, end } = data;
  const phases = [new Phase(workStart, workEnd, data, links)];
  if (data.approach) phases.unshift(new Phase(start, workStart, data.approach, links, "approach"));
  if (data.return) phases.push(new Phase(workEnd, end, data.return, links, "return"));
  else if (data.rest) phases.push(new Phase(workEnd, end, data.rest, links));
  return phases;
}
