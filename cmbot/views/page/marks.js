// Marks in the 3-D view: the smallest clearance as a line, and the tool's deflection, magnified.
const TRACED = 160;  // places of the tool along its path

class Marks {
  constructor(stage, data) {
    Object.assign(this, { stage, data, factor: 0 });
    this.thick = 0.004 * data.reach;
    this.near = {};
    this.bent = {};
    for (const name of MOTIONS) {
      this.near[name] = this.addStick(COLOURS.near, 1);
      this.bent[name] = this.addStick(COLOURS[name], 2.2);
      this.bent[name].trace = this.addTrace(COLOURS[name]);
      this.near[name].on = this.bent[name].on = false;
    }
  }

  // Drawn in front of everything.
  material(kind, colour) {
    return new kind({ color: colour, transparent: true, opacity: 0.95, depthTest: false });
  }

  addStick(colour, headSize) {
    const material = this.material(THREE.MeshBasicMaterial, colour);
    const part = (geometry) => {
      const mesh = new THREE.Mesh(geometry, material);
      mesh.renderOrder = 4;
      return mesh;
    };
    const rod = part(new THREE.CylinderGeometry(0.5, 0.5, 1, 12).rotateX(Math.PI / 2).translate(0, 0, 0.5));
    const ends = [0, 1].map((k) => part(new THREE.SphereGeometry((k ? headSize : 1) * this.thick, 16, 12)));
    const group = new THREE.Group();
    group.add(rod, ...ends);
    this.stage.world.add(group);
    return { group, rod, ends, material, from: new THREE.Vector3(), to: new THREE.Vector3() };
  }

  addTrace(colour) {
    const line = new THREE.Line(new THREE.BufferGeometry(), this.material(THREE.LineBasicMaterial, colour));
    line.renderOrder = 4;
    line.frustumCulled = false;
    this.stage.world.add(line);
    return line;
  }

  place(stick, from, to) {
    stick.from.copy(from);
    stick.to.copy(to);
    const along = to.clone().sub(from), length = Math.max(along.length(), 1e-9);
    stick.rod.position.copy(from);
    stick.rod.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), along.normalize());
    stick.rod.scale.set(this.thick, this.thick, length);
    stick.ends[0].position.copy(from);
    stick.ends[1].position.copy(to);
  }

  // Nearest points of one motion; null: nothing is near.
  setNear(name, found) {
    const stick = this.near[name];
    stick.on = found !== null;
    if (!found) return;
    const { bending } = this.stage, joints = this.data.pairJoints[found.pair];
    const ends = [found.point, found.other].map((p, k) => bending?.carried(name, joints[k], p) ?? p);
    this.place(stick, ...ends);
    stick.material.color.setHex(found.distance < this.data.margin ? COLOURS.tooNear : COLOURS.near);
  }

  // The tool of one motion, rigid and bent, if it was simulated.
  setBent(name, motion, moment) {
    const stick = this.bent[name];
    stick.on = motion.error !== null;
    if (!stick.on) return;
    const { bending, data } = this.stage;
    this.place(stick, motion.toolAt(moment), this.bentTool(motion, moment, (tool) => bending.carried(name, data.links.length, tool)));
  }

  // A compensated plan expects its tool elsewhere than the rigid arm has it: the error from there is magnified.
  bentTool(motion, moment, bent) {
    const tool = motion.toolAt(moment);
    return motion.expected ? tool.addScaledVector(motion.errorAt(moment), this.factor) : bent(tool);
  }

  // The elastic arm's tool path during the work, its bending times `factor`.
  setFactor(factor, motions) {
    this.factor = factor;
    for (const name of MOTIONS) {
      if (!motions[name].error) continue;
      const motion = motions[name], share = (k) => k / (TRACED - 1), { bending } = this.stage;
      const places = Array.from({ length: TRACED }, (_, k) => this.bentTool(motion, share(k), (tool) => bending.toolAt(name, motion, share(k), tool, factor)));
      this.bent[name].trace.geometry.setFromPoints(places);
    }
  }

  // Show the marks of a motion; with the ghost, of both.
  show(motion, compare) {
    for (const name of MOTIONS) {
      const wanted = name === motion || compare === "ghost";
      // Nearest points are those of the rigid arm, drawn where the bent one has them.
      this.near[name].group.visible = wanted && this.near[name].on;
      this.bent[name].group.visible = wanted && this.bent[name].on && this.factor > 0;
      this.bent[name].trace.visible = wanted && this.factor > 0;
    }
  }
}
