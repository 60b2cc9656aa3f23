"""The panel's own part of the page: a stop that lies over it, a line when the program is gone, bars in the rows of
sliders, pictures that are buttons.

The stop is no part of viser, so that it is there, and works, whatever viser does. The bars are drawn into viser's rows
from what `page.html.joint_states` sends; without them sliders are plain sliders.
"""

from __future__ import annotations

TITLE = "Allegro hand"
_COARSE = 0.6
"""Pixels of the picture for each of the screen's, each way, where no GPU draws it."""
_BEAT, _PATIENCE = 500, 1000
"""ms between two questions of the page whether the program is there, and for an answer: together below 2 s."""
_BEFORE = """
<script>
(() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const more = gl && gl.getExtension("WEBGL_debug_renderer_info");
  const name = more ? gl.getParameter(more.UNMASKED_RENDERER_WEBGL) : "";
  const given = new URLSearchParams(location.search);
  if (/swiftshader|llvmpipe|software/i.test(name) && !given.has("fixedDpr")) {
    given.set("fixedDpr", COARSE);
    history.replaceState(null, "", "?" + given);
  }
})();
</script>
""".replace("COARSE", str(_COARSE))
_STOP = """
<style>
  #stop { position: fixed; left: 20px; bottom: 20px; z-index: 2147483647; width: 132px; height: 64px; border: 0;
    border-radius: 10px; background: #c8102e; color: #fff; font: 700 26px/1 system-ui, sans-serif;
    letter-spacing: 2px; box-shadow: 0 2px 8px #0006; cursor: pointer; touch-action: none; }
  #stop:active { background: #8a0b20; }
  .lost #stop { background: #8b8f94; box-shadow: none; }
  #lost { display: none; position: fixed; left: 0; top: 0; right: 0; z-index: 2147483647; padding: 12px 20px;
    background: #c8102e; color: #fff; font: 700 16px/1.4 system-ui, sans-serif; text-align: center; }
  .lost #lost { display: block; }
  #stop small { display: block; margin-top: 5px; font: 400 11px/1 system-ui, sans-serif; letter-spacing: 0; }
</style>
<button id="stop" title="No torque from the next period on. Everybody may press it.">STOP<small>or Esc</small></button>
<div id="lost" role="alert">Connection to the program lost: STOP of this page does nothing</div>
<script>
(() => {
  const button = document.getElementById("stop"), face = button.innerHTML;
  let wait = 0;
  const say = (text) => {
    button.textContent = text;
    clearTimeout(wait);
    wait = setTimeout(() => { button.innerHTML = face; }, 2000);
  };
  const stop = async () => {
    say("…");
    try {
      const answer = await fetch("/stop", { method: "POST", keepalive: true });
      say(answer.ok ? "STOPPED" : "REFUSED");
    } catch { say("NO LINK"); }
  };
  const lost = (is) => document.documentElement.classList.toggle("lost", is);
  const listen = async () => {
    try {
      lost(!(await fetch("/alive", { cache: "no-store", signal: AbortSignal.timeout(PATIENCE) })).ok);
    } catch { lost(true); }
    setTimeout(listen, BEAT);
  };
  listen();
  button.addEventListener("pointerdown", stop);
  button.addEventListener("click", (event) => { if (event.detail === 0) stop(); });
  addEventListener("keydown", (event) => { if (event.key === "Escape") stop(); }, true);
})();
</script>
""".replace("BEAT", str(_BEAT)).replace("PATIENCE", str(_PATIENCE))
_ROWS = """
<style>
  .joint-states { display: flex; font: 11px/1.4 system-ui, sans-serif; color: #777; padding: 0 22px 0 0; }
  .joint-states span { text-align: right; }
  .joint-states span:first-child { flex: 1; }
  .joint-row > div:first-child { width: 5.6em !important; }
  .joint-row .mantine-NumberInput-root { width: 2.7rem !important; }
  .joint-row .mantine-Slider-bar, .joint-row .mantine-Slider-markWrapper { display: none; }
  .joint-row .mantine-Slider-track { background: #dfe4ea; border-radius: 3px; height: 6px; }
  .joint-row .mantine-Slider-track::before { background: transparent; }
  .joint-bar { position: absolute; left: 0; top: 0; bottom: 0; border-radius: 3px; }
  .joint-is, .joint-states .is { width: 44px; }
  .joint-is { font: 12px/1 system-ui, sans-serif; font-variant-numeric: tabular-nums; text-align: right;
    align-self: center; letter-spacing: -0.3px; color: #333; }
  .joint-torque, .joint-states .torque { width: 52px; margin-left: 10px; }
  .joint-torque { position: relative; align-self: center; height: 8px; border-radius: 4px; background: #e6eaef; }
  .joint-torque::after { content: ""; position: absolute; left: 50%; top: -2px; bottom: -2px; width: 1px;
    background: #222; }
  .joint-torque i { position: absolute; top: 0; bottom: 0; border-radius: 4px; }
  .library-row { display: flex; gap: 0.375em; padding: 4px 10px 2px; }
  .library-row div { flex: 1 1 0; text-align: center; height: 76px; cursor: pointer; }
  div:has(> .library-row) + div > div > div:first-child { display: none; }
  .library-row img { height: 76px; }
</style>
<script>
(() => {
  const rows = new Map();
  let before = "";
  const made = (name, color) => {
    for (const label of document.querySelectorAll("label[for]")) {
      const slider = label.textContent === name && document.getElementById(label.htmlFor);
      const track = slider && slider.querySelector(".mantine-Slider-track");
      if (!track) continue;
      const add = (to, tag, kind) => {
        const node = document.createElement(tag);
        node.className = kind;
        return to.appendChild(node);
      };
      const cells = slider.parentElement, row = cells.parentElement.parentElement.parentElement;
      row.classList.add("joint-row");
      row.dataset.joint = name;
      const bar = add(track, "i", "joint-bar"), is = add(cells, "span", "joint-is");
      const torque = add(cells, "div", "joint-torque"), effort = add(torque, "i", "");
      bar.style.background = effort.style.background = color;
      return { row, bar, is, torque, effort };
    }
    return null;
  };
  setInterval(() => {
    const node = document.querySelector(".joint-states"), text = node ? node.dataset.joints : "";
    if (!text || text === before || node.offsetParent === null) return;
    before = text;
    for (const [name, color, part, position, effort, torque] of JSON.parse(text)) {
      let row = rows.get(name);
      if (!row || !row.row.isConnected) rows.set(name, row = made(name, color));
      if (!row) continue;
      row.bar.style.width = `${100 * part}%`;
      row.is.textContent = position;
      row.torque.title = `${torque} N·m`;
      row.effort.style.left = `${50 + 50 * Math.min(effort, 0)}%`;
      row.effort.style.width = `${50 * Math.abs(effort)}%`;
    }
  }, 100);
  addEventListener("click", (event) => {
    const cell = event.target.closest(".library-row > div");
    if (!cell) return;
    const row = cell.parentElement, buttons = row.parentElement.nextElementSibling.querySelectorAll("button");
    buttons[[...row.children].indexOf(cell)].click();
  });
})();
</script>
"""


def page(index: str) -> bytes:
    """viser's page with the panel's own part."""
    index = index.replace("<title>Viser</title>", f"<title>{TITLE}</title>")
    begin, end = index.index("<head>") + len("<head>"), index.rindex("</body>")
    return (index[:begin] + _BEFORE + index[begin:end] + _STOP + _ROWS + index[end:]).encode()
