// What links, base and rails bear, as colours: shares of their bounds, or the strain of their outer fibres.
const SHADES = 128;
const HEAT = [0xdfe5ea, 0xfee08b, 0xfdae4b, 0xf46d2f, 0xcb181d, 0x67000d].map((colour) => new THREE.Color(colour));
// Shades from nothing to the most: from green to red at the bound, of strain the darker the more.
const SCALES = {
  load: (share) => new THREE.Color().setHSL(0.36 * (1 - share), 0.85, 0.45),
  strain: (share) => {
    const at = share * (HEAT.length - 1), low = Math.min(Math.floor(at), HEAT.length - 2);
    return HEAT[low].clone().lerp(HEAT[low + 1], at - low);
  },
};
const shadesOf = (kind) => Array.from({ length: SHADES }, (_, k) => SCALES[kind](k / (SHADES - 1)));

// The largest strain at both ends of beams, linear in elastic coordinates for each fibre.
class Strains {
  constructor({ rows, width, first, outlines, outline }) {
    Object.assign(this, { rows: floats(rows), width, first, outlines: outline.map((k) => outlines[k]) });
  }

  at(u) {
    const { rows, width, first, outlines } = this, largest = new Float32Array(2 * first.length);
    const row = new Float64Array(3);
    for (let k = 0; k < largest.length; k += 1) {
      const beam = k >> 1, { corners, radius } = outlines[beam];
      row.fill(0);
      for (let i = 0; i < 3 * width; i += 1) row[Math.floor(i / width)] += rows[3 * width * k + i] * u[first[beam] + (i % width)];
      const [stretch, v, w] = row;
      for (const [y, z] of corners) largest[k] = Math.max(largest[k], Math.abs(stretch - y * v - z * w));
      largest[k] += radius * Math.hypot(v, w);
    }
    return largest;
  }
}

class Colours {
  constructor(stage, { bending }) {
    Object.assign(this, { kind: "own", top: 0, largest: 0, values: {} });
    this.parts = [...stage.arms[MOTIONS[0]], stage.node("robot", "0")].flatMap((node, link) => {
      const found = [];
      node.traverse((mesh) => { if (mesh.material) found.push(this.part(mesh, link)); });
      return found;
    });
    if (!bending) return;
    const [first] = bending.chains;
    if (!first) return;
    const tubes = new Strains(first.strains), of = new Map(this.parts.map((part) => [part.mesh, part]));
    stage.bending.arms[MOTIONS[0]].forEach((skins, link) => {
      for (const { mesh, stations } of skins) this.addStrains(of.get(mesh), tubes, alongTube(first.links[link].beams, stations));
    });
    if (!first.frame?.strains) return;
    const frame = new Strains(first.frame.strains);
    for (const { mesh, stations } of stage.bending.grounds[MOTIONS[0]]) {
      this.parts.push(this.part(mesh, null));
      this.addStrains(this.parts.at(-1), frame, alongMembers(stations));
    }
  }

  part(mesh, link) {
    return { mesh, link, own: mesh.material.color.clone(), strains: null };
  }

  // The vertices of a part are `along` a beam each, in shares of it; -1: a vertex of no beam.
  addStrains(part, strains, { beams, along }) {
    const colours = new Float32Array(3 * beams.length);
    part.mesh.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    Object.assign(part, { strains, beams, along, colours });
  }

  choose(kind) {
    this.kind = kind;
    if (kind !== "own") this.shades = shadesOf(kind);
    this.paint(MOTIONS[0]);
  }

  // The colours of one motion: of its links' and its base's `loads`, null where not known, or of the strains by `u`.
  paint(name) {
    const { kind } = this, { loads, u } = this.values[name], ends = new Map();
    for (const part of this.parts) {
      const { mesh: { material }, link, own, strains } = part, strained = Boolean(kind === "strain" && u && strains);
      if (material.vertexColors !== strained) Object.assign(material, { vertexColors: strained, needsUpdate: true });
      if (strained) {
        if (!ends.has(strains)) ends.set(strains, strains.at(u));
        material.color.setHex(0xffffff);
        this.paintVertices(part, ends.get(strains));
      } else material.color.copy(kind === "load" && Number.isFinite(loads[link] ?? NaN) ? this.shade(loads[link]) : own);
    }
    this.largest = Math.max(0, ...[...ends.values()].map((values) => values.reduce((most, each) => Math.max(most, each), 0)));
  }

  paintVertices({ mesh, own, beams, along, colours }, ends) {
    for (let k = 0; k < beams.length; k += 1) {
      const start = ends[2 * beams[k]], value = start + along[k] * (ends[2 * beams[k] + 1] - start);
      (beams[k] < 0 ? own : this.shade(value / this.top)).toArray(colours, 3 * k);
    }
    mesh.geometry.attributes.color.needsUpdate = true;
  }

  shade(share) {
    return this.shades[Math.round(Math.min(Math.max(share, 0), 1) * (SHADES - 1))];
  }
}

// In which segment of a tube vertices are, by their stations; what lies before or behind the tube does not bend.
function alongTube(segments, stations) {
  const beams = new Int32Array(stations.length), along = new Float32Array(stations.length);
  stations.forEach((station, k) => {
    const at = (station / STATIONS) * segments.length, low = Math.min(Math.floor(at), segments.length - 1);
    beams[k] = station > 0 && station < STATIONS ? segments[low] : -1;
    along[k] = at - low;
  });
  return { beams, along };
}

// Which members vertices are beside, by their stations: every member has two.
function alongMembers(stations) {
  const beams = Int32Array.from(stations, (station) => station >> 1);
  return { beams, along: stations.map((station, k) => station - 2 * beams[k]) };
}

// A number from which a scale is easily read, at least `most`.
function roundedUp(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10].find((factor) => factor * power >= most * (1 - 1e-9));
}

// What the colours mean, in a corner of the view.
class Legend {
  constructor(colours, holds) {
    this.colours = colours;
    this.element = document.getElementById("legend");
    [this.title, this.scale, this.end] = ["title", "scale", "top"].map((part) => document.getElementById(`legend-${part}`));
    this.share = holds ? "joint torque and hold, share of the bound" : "joint torque, share of its bound";
  }

  choose(kind) {
    this.element.hidden = kind === "own";
    if (kind === "own") return;
    const shades = Array.from({ length: 9 }, (_, k) => SCALES[kind](k / 8).getStyle());
    this.scale.style.background = `linear-gradient(90deg, ${shades.join(", ")})`;
    this.end.textContent = kind === "load" ? "100 %" : microstrain(this.colours.top);
    this.update(kind);
  }

  update(kind) {
    this.title.textContent = kind === "load" ? this.share : `strain, largest now ${microstrain(this.colours.largest)}`;
  }
}

const microstrain = (value) => `${(1e6 * value).toFixed(0)} µε`;
