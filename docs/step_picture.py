"""Draws docs/images/step.svg: the reading of a balance that rings after a cut cable, and the force found in it.

python docs/step_picture.py [--seed 1]

Colours follow the page, light or dark. The traces are drawn in five seconds, once, and stand whole where no
motion is wanted.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import aerobalance as ab
from aerobalance.simulation import CableCut, Sensor

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 740, 350, 86, 16, 40, 56
BEGIN, END, LEAST, LARGEST = -0.05, 0.4, -1250.0, 1250.0
STYLE = """
svg.step text { font: 13px sans-serif; fill: currentColor; }
svg.step .grid { stroke: currentColor; stroke-opacity: 0.15; }
svg.step .reading { stroke: #7d8ea3; stroke-width: 1.4; fill: none; }
svg.step .force { stroke: #d9480f; stroke-width: 3; fill: none; }
svg.step .shown { transform-origin: 0 0; animation: reveal 5s linear 0.5s backwards; }
@keyframes reveal { from { transform: scaleX(0); } to { transform: scaleX(1); } }
@media (max-width: 500px) { svg.step text { font-size: 18px; } }
@media (prefers-reduced-motion: reduce) { svg.step .shown { animation: none; } }
"""


def across(time: float) -> float:
    """Place of an instant [px]."""
    return LEFT + (WIDTH - LEFT - RIGHT) * (time - BEGIN) / (END - BEGIN)


def down(load: float) -> float:
    """Place of a load [px]."""
    return TOP + (HEIGHT - TOP - BOTTOM) * (LARGEST - load) / (LARGEST - LEAST)


def trace(kind: str, time: np.ndarray, load: np.ndarray) -> str:
    """A line through samples."""
    points = " ".join(f"{across(t):.1f},{down(y):.1f}" for t, y in zip(time, load, strict=True))
    return f'<polyline class="{kind}" points="{points}"/>'


def picture(seed: int) -> str:
    """The picture as SVG."""
    rig = CableCut(sensors={"AF": Sensor(noise=2.0)})
    run = rig.run(3.0, np.random.default_rng(seed)).recording
    force = ab.estimate_force(run, rig.dynamics)["AF"].values
    time = run.time - rig.release
    kept = (time >= BEGIN) & (time <= END)
    parts = []
    for load in range(-1000, 1001, 500):
        y = down(load)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{str(load).replace("-", "−")}</text>')
    for tenth in range(5):
        x = across(tenth / 10)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 21}" text-anchor="middle">{tenth / 10:g}</text>')
    middle = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(f'<text x="{across(0.175):.1f}" y="{HEIGHT - 8}" text-anchor="middle">time from the cut [s]</text>')
    parts.append(
        f'<text x="14" y="{middle}" text-anchor="middle" transform="rotate(-90 14 {middle})">axial force [N]</text>'
    )
    for x, kind, words in ((LEFT + 40, "reading", "what the balance reads"), (LEFT + 340, "force", "force recovered")):
        parts.append(f'<line class="{kind}" x1="{x}" x2="{x + 34}" y1="18" y2="18"/>')
        parts.append(f'<text x="{x + 42}" y="22">{words}</text>')
    inside = f'x="0" y="0" width="{WIDTH}" height="{HEIGHT}"'
    parts.append(f'<clipPath id="revealed"><rect class="shown" {inside}/></clipPath>')
    traces = trace("reading", time[kept], run.channel("AF").values[kept]) + trace("force", time[kept], force[kept])
    parts.append(f'<g clip-path="url(#revealed)">{traces}</g>')
    title = (
        "A cable that pulled with 1.02 kN is cut: the ringing reading of the balance, and the force recovered from it"
    )
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" class="step">'
    return "\n".join([head, f"<title>{title}</title>", f"<style>{STYLE}</style>", *parts, "</svg>", ""])


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--seed", type=int, default=1)
    chosen = arguments.parse_args()
    target = Path(__file__).parent / "images" / "step.svg"
    target.write_text(picture(chosen.seed), encoding="utf-8")
