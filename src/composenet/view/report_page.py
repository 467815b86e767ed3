"""Style and script of report.html. No network access, no fonts to load."""

from __future__ import annotations

STYLE = """
:root { --ink: #1d2330; --soft: #626b7a; --line: #e3e7ed; --paper: #fff; --ground: #f5f7fa; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 24px 20px 60px; }
h1 { font-size: 26px; margin: 0 0 2px; letter-spacing: -0.01em; }
h2 { font-size: 17px; margin: 0 0 10px; }
p { margin: 0; } .soft { color: var(--soft); } .small { font-size: 13px; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 10px;
  padding: 16px 18px; margin-top: 16px; }
.facts { display: flex; flex-wrap: wrap; gap: 12px; margin-top: 16px; }
.fact { background: var(--paper); border: 1px solid var(--line); border-radius: 10px;
  padding: 10px 18px; min-width: 130px; }
.fact b { display: block; font-size: 22px; font-weight: 650; font-variant-numeric: tabular-nums; }
.fact span { color: var(--soft); font-size: 13px; }
.pair { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 16px; }
.triple { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 16px; }
@media (max-width: 860px) { .pair, .triple { grid-template-columns: minmax(0, 1fr); } }
.warn { border-left: 4px solid #e6a817; } .warn ul { margin: 0; padding-left: 18px; }
#picture { width: 100%; display: block; border-radius: 6px; background: #ddd; }
.slider { display: flex; gap: 12px; align-items: center; margin-top: 10px; }
.slider input { flex: 1; accent-color: #3b6fd4; }
.slider output { min-width: 130px; text-align: right; font-variant-numeric: tabular-nums; }
svg { display: block; width: 100%; height: auto; } svg text { font-family: inherit; }
.scroll { max-height: 560px; overflow: auto; }
.legend { display: flex; flex-wrap: wrap; gap: 16px; margin-top: 8px; font-size: 13px;
  color: var(--soft); }
.legend svg { display: inline-block; width: 22px; height: 12px; margin-right: 6px;
  vertical-align: -1px; }
table { border-collapse: collapse; width: 100%; font-size: 14px;
  font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--soft); font-size: 13px; }
th, td { padding: 5px 10px 5px 0; border-bottom: 1px solid var(--line); white-space: nowrap; }
td.n, th.n { text-align: right; } tr:last-child td { border-bottom: 0; }
.dot { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 7px; }
a { color: #2c5fc4; } #scene { height: 540px; }
"""

SCRIPT = """
const run = JSON.parse(document.getElementById('run-data').textContent);
const picture = document.getElementById('picture');
const slider = document.getElementById('slider');
const shown = document.getElementById('shown');
const cursor = document.getElementById('cursor');
const eye = document.getElementById('eye');
function show(n) {
  const p = run.pictures[n];
  if (!p) return;
  picture.src = 'data:image/jpeg;base64,' + p.jpeg;
  picture.alt = p.alt;
  shown.textContent = 'frame ' + p.frame;
  slider.value = n;
  slider.setAttribute('aria-valuetext', 'frame ' + p.frame);
  cursor.setAttribute('transform', 'translate(' + p.timeline_x + ' 0)');
  eye.setAttribute('transform', p.eye);
}
if (slider) {
  slider.addEventListener('input', () => show(Number(slider.value)));
  document.getElementById('timeline').addEventListener('click', (event) => {
    const box = event.currentTarget.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * run.timeline_width;
    let best = 0;
    run.pictures.forEach((p, n) => {
      if (Math.abs(p.timeline_x - x) < Math.abs(run.pictures[best].timeline_x - x)) best = n;
    });
    show(best);
  });
  show(Number(slider.value));
}
"""
