// The page of a walk: the whole robot, its feet and its moving joints in the colours of what they bear.
class WalkPlayer extends Player {
  seek(time) {
    super.seek(time);
    const { parts, links } = this.data, part = parts.findLast(([begin]) => begin <= this.time) ?? parts[0];
    this.put("subtitle", part[1]);
    const { loads } = this.stage.colours.values[MOTIONS[0]];
    const feet = [1, 2].map((foot) => loads[links.indexOf(`foot_${foot}`)]);
    feet.forEach((share, k) => {
      this.put(`foot-${k + 1}`, Number.isFinite(share) ? percent(share) : part[2][k]);
      const shown = Number.isFinite(share) ? SCALES.load(Math.min(share, 1)).getStyle() : "transparent";
      document.getElementById(`swatch-${k + 1}`).style.background = shown;
    });
    this.put("effort", percent(Math.max(...loads.filter((share, k) => Number.isFinite(share) && !links[k]?.startsWith("foot_")))));
  }
}

const percent = (share) => `${Math.round(100 * share)} %`;

start((data) => {
  const player = new WalkPlayer(data, () => {});
  player.stage.withArrow = false;
  player.ui.arrow.closest("label").hidden = true;
  player.ui.colours.querySelector("[value=load]").textContent = "what is borne";
  player.legend.share = "share of what it can bear";
  player.colour("load");
  return player;
});
