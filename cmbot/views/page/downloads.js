// Files of a page: the whole planned job as a table and as a ROS message, from its knots, and the view as a picture.
const STEP = 0.01;  // s

const doubles = (text) => new Float64Array(bytesOf(text).buffer);

// Position, velocity and acceleration of every joint at a time: quintics between knots (Chang 2021, Eq. (28)).
class Knots {
  constructor(source, joints) {
    for (const name of ["t", "q", "v", "a"]) this[name] = doubles(source[name]);
    this.joints = joints;
  }

  at(time) {
    const { t, joints } = this, last = t.length - 2;
    let k = 0;
    while (k < last && t[k + 1] <= time) k += 1;
    const h = t[k + 1] - t[k], s = time - t[k];
    const ends = (values, joint) => [values[k * joints + joint], values[(k + 1) * joints + joint]];
    const states = [[], [], []];
    for (let joint = 0; joint < joints; joint += 1) {
      const [q0, q1] = ends(this.q, joint), [v0, v1] = ends(this.v, joint), [a0, a1] = ends(this.a, joint);
      const d = q1 - q0;
      const c3 = (20 * d - (8 * v1 + 12 * v0) * h - (3 * a0 - a1) * h * h) / (2 * h ** 3);
      const c4 = (-30 * d + (14 * v1 + 16 * v0) * h + (3 * a0 - 2 * a1) * h * h) / (2 * h ** 4);
      const c5 = (12 * d - 6 * (v1 + v0) * h + (a1 - a0) * h * h) / (2 * h ** 5);
      states[0].push(q0 + s * (v0 + s * (a0 / 2 + s * (c3 + s * (c4 + s * c5)))));
      states[1].push(v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5))));
      states[2].push(a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5)));
    }
    return states;
  }
}

class Downloads {
  constructor(player) {
    const { data } = player;
    this.player = player;
    document.getElementById("save-png").addEventListener("click", () => this.save(player.stage.still(), "view.png"));
    for (const kind of ["csv", "ros"]) document.getElementById(`save-${kind}`).hidden = !data.knots;
    if (!data.knots) return;
    this.knots = new Knots(data.knots, data.joints.length);
    const end = this.knots.t.at(-1), count = Math.floor((end / STEP) * (1 + 1e-12));
    this.times = Array.from({ length: count + 1 }, (_, k) => k * STEP);
    if (end - this.times[count] > 1e-9 * end) this.times.push(end);
    const kinds = { csv: () => [this.csv(), "text/csv", "job.csv"], ros: () => [this.ros(), "application/json", "job.ros.json"] };
    for (const [kind, content] of Object.entries(kinds)) {
      document.getElementById(`save-${kind}`).addEventListener("click", () => {
        const [text, type, name] = content();
        const url = URL.createObjectURL(new Blob([text], { type }));
        this.save(url, name);
        setTimeout(() => URL.revokeObjectURL(url), 10000);
      });
    }
  }

  save(address, name) {
    const link = document.createElement("a");
    link.href = address;
    link.download = `${this.player.data.title.replace(/[^\w-]+/g, "_")}_${name}`;
    link.click();
  }

  // A row every 0.01 s with columns of a plan directory's job.csv.
  csv() {
    const { data } = this.player, { joints, segments } = data;
    const columns = ["q", "v", "a"].flatMap((letter) => joints.map((_, i) => `${letter}${i + 1}`));
    const torque = ["x", "y", "z"].map((axis) => `guardrail_torque_${axis}`);
    const rows = this.times.map((time) => {
      const [phase, moment] = this.player.at(time), motion = phase.motions[MOTIONS[0]];
      const [name] = segments.find(([, , end]) => time <= end + 1e-9) ?? segments.at(-1);
      const values = [time, ...this.knots.at(time).flat(), ...motion.torqueAt(moment).toArray(), motion.clearanceAt(moment)];
      return [...values.map((value) => Number(value.toPrecision(15))), name].join(",");
    });
    return [["t", ...columns, ...torque, "clearance", "segment"].join(","), ...rows, ""].join("\n");
  }

  // The same motion as a trajectory_msgs/JointTrajectory.
  ros() {
    const points = this.times.map((time) => {
      const [positions, velocities, accelerations] = this.knots.at(time);
      const sec = Math.floor(time + 1e-9), nanosec = Math.max(Math.round((time - sec) * 1e9), 0);
      return { positions, velocities, accelerations, effort: [], time_from_start: { sec, nanosec } };
    });
    const header = { stamp: { sec: 0, nanosec: 0 }, frame_id: "" };
    return JSON.stringify({ header, joint_names: this.player.data.joints, points });
  }
}
