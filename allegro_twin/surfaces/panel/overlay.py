"""The stop that lies over the page: no part of viser, so that it is there, and works, whatever that does."""

from __future__ import annotations

TITLE = "Allegro hand"
_COARSE = 0.6
"""Pixels of the picture for each of the screen's, each way, where no GPU draws it."""
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
_OVER = """
<style>
  #stop { position: fixed; left: 20px; bottom: 20px; z-index: 2147483647; width: 132px; height: 64px; border: 0;
    border-radius: 10px; background: #c8102e; color: #fff; font: 700 26px/1 system-ui, sans-serif;
    letter-spacing: 2px; box-shadow: 0 2px 8px #0006; cursor: pointer; touch-action: none; }
  #stop:active { background: #8a0b20; }
  #stop small { display: block; margin-top: 5px; font: 400 11px/1 system-ui, sans-serif; letter-spacing: 0; }
</style>
<button id="stop" title="No torque from the next period on. Everybody may press it.">STOP<small>or Esc</small></button>
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
      say(answer.ok ? "LIMP" : "REFUSED");
    } catch { say("NO LINK"); }
  };
  button.addEventListener("pointerdown", stop);
  button.addEventListener("click", (event) => { if (event.detail === 0) stop(); });
  addEventListener("keydown", (event) => { if (event.key === "Escape") stop(); }, true);
})();
</script>
"""


def page(index: str) -> bytes:
    """viser's page with the stop over it."""
    index = index.replace("<title>Viser</title>", f"<title>{TITLE}</title>")
    begin, end = index.index("<head>") + len("<head>"), index.rindex("</body>")
    return (index[:begin] + _BEFORE + index[begin:end] + _OVER + index[end:]).encode()
