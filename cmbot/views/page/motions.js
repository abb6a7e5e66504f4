// The motions as functions of time: the arms move in phases, first the approach if there is one, then the work.
class Motion {
  constructor(source, links) {
    this.links = links;
    this.poses = floats(source.poses);
    this.torque = floats(source.torque);
    this.clearance = floats(source.clearance);
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

  torqueAt(moment) {
    const [frame, share] = this.between(moment);
    const v = [0, 1].map((k) => new THREE.Vector3().fromArray(this.torque, 3 * (frame + k)));
    return v[0].lerp(v[1], share);
  }

  clearanceAt(moment) {
    const [frame, share] = this.between(moment);
    return (1 - share) * this.clearance[frame] + share * this.clearance[frame + 1];
  }
}

// A stretch of the timeline in which both arms have a motion each.
class Phase {
  constructor(start, end, label, source, links) {
    Object.assign(this, { start, end, label });
    this.motions = {
      planned: new Motion(source.planned, links), baseline: new Motion(source.baseline, links) };
    this.peak = Math.max(source.planned.peakTorque, source.baseline.peakTorque);
  }

  share(time) {
    return (time - this.start) / (this.end - this.start);
  }

  timeOf(share) {
    return this.start + share * (this.end - this.start);
  }
}

function phasesOf(data) {
  const links = data.links.length;
  const work = new Phase(0, data.duration, "", data, links);
  return data.approach ? [new Phase(data.start, 0, data.approach.label, data.approach, links), work] : [work];
}
