"""HTML report of an identification: values with uncertainties, model and measurement, friction, missing data.

One file with nothing from elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.twin.identify.fitting.parameterisation import NAMES
from allegro_twin.twin.identify.fitting.regress import smooth_motion
from allegro_twin.twin.identify.fitting.shooting import cut_segments
from allegro_twin.twin.identify.pipeline import Identification
from allegro_twin.twin.identify.results.findings import describe
from allegro_twin.twin.identify.results.hand_file import SCALE
from allegro_twin.twin.identify.results.uncertainty import PER_PWM, VALUES
from allegro_twin.types import Array
from allegro_twin.viewing.report import ChartLine, html_page, line_chart

_UNITS = {
    "torque_constant": ("torque constant, N·m", 1.0), "armature": ("armature / k, g·m²", 1e3),
    "damping": ("damping / k, mN·m·s/rad", 1e3), "frictionloss": ("friction / k, mN·m", 1e3),
    "offset": ("offset, mrad", 1e3), "stiction": ("F_s / F_c", 1.0), "stribeck_speed": ("v_s, rad/s", 1.0),
    "bristle": ("bristle, mrad", 1e3), "load_friction": ("load friction, %", 100.0),
    "backlash": ("backlash, mrad", 1e3), "bias_torque": ("constant torque / k, mN·m", 1e3),
    "stiffness": ("stiffness / k, mN·m/rad", 1e3),
    "gear_compliance": ("teeth bend, mrad/(N·m)", 1e3), "cold_friction": ("more friction when cold, %", 100.0),
    "ripple_cosine": ("ripple, cosine, %", 100.0), "ripple_sine": ("ripple, sine, %", 100.0),
    "uneven_damping": ("damping by direction / k, mN·m·s/rad", 1e3),
    "cogging_cosine": ("cogging, cosine / k, mN·m", 1e3), "cogging_sine": ("cogging, sine / k, mN·m", 1e3),
}  # fmt: skip
_SHOWN = 1.0  # s of motion in a picture.


def report_page(found: Identification) -> str:
    """Text of the HTML file."""
    first = found.motions[0]
    title = f"The drive of {first.spec.name} {first.spec.serial}".strip()
    about = f"{ENGINE} · friction {'LuGre' if found.fit.bristly else 'Coulomb'} · backlash {_play(found)} · "
    about += f"{len(found.motions)} recordings, " + (
        f"{sum(motion.seconds for motion in found.motions):.0f} s · N·m from {SCALE[found.fit.masses]}"
    )
    parts = (
        summary(found),
        values_table(found),
        missing_values(found),
        motion_figures(found),
        spectrum_figures(found),
        friction_figures(found),
        spread_tables(found),
    )
    return html_page(title, about, parts)


def summary(found: Identification) -> str:
    """What the hand has, and how well each drive predicts what the fit has not seen, joint by joint."""
    labels, written = _joints(found), found.written
    said = describe(found.fit, found.values, found.motions, written)
    text = "".join(f"<p>{escape(line)}</p>" for line in said)
    if not written.errors:
        return text
    heads = "".join(
        f"<th{' class=n' * (name in written.errors)}>{name}</th>" for name in ("joint", *written.errors, "file has")
    )
    lines = []
    for joint, alias in enumerate(labels):
        cells = "".join(f"<td class='n'>{1e3 * row[joint]:.1f}</td>" for row in written.errors.values())
        lines.append(f"<tr><td>{escape(alias)}</td>{cells}<td>{written.source[joint]}</td></tr>")
    return (
        f"{text}<h2>What the fit has not seen</h2><p class='soft'>Root mean square error of {written.seconds:.1f} s of "
        "open loop in the part that was kept back, mrad: with the nominal drive, with the determined values alone, "
        "with all values, and with what is written.</p>"
        f"<div class='wide'><table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def figure_card(title: str, caption: str, drawing: str) -> str:
    return f"<figure><h3>{escape(title)}</h3><figcaption class='soft'>{escape(caption)}</figcaption>{drawing}</figure>"


def values_table(found: Identification) -> str:
    """Table with one row per joint."""
    names = [name for name in _UNITS if name in found.values]
    stops = np.isfinite(found.end_stop_offsets).all()
    both = ("offset by end stops, mrad", "by weight − by stops") if stops else ()
    titles = ("joint", *(_UNITS[name][0] for name in names), *both, "residual")
    heads, lines = "".join(f"<th{' class=n' * (each != 'joint')}>{escape(each)}</th>" for each in titles), []
    for joint, alias in enumerate(_joints(found)):
        cells = [_cell(found, name, joint) for name in names] + (_by_stops(found, joint) if stops else [])
        left = f"<td class='n'>{found.fit.spread.residual[joint]:.1f} × noise</td>"
        lines.append(f"<tr><td>{escape(alias)}</td>{''.join(cells)}{left}</tr>")
    late = found.values["delay"]
    delay = "not determined" if late.reason[0] else f"{1000 * late.value[0]:.2f} ± {1000 * late.half[0]:.2f} ms"
    return (
        "<h2>Values</h2><p class='soft'>± half of the 95 % interval; – is not determined, or not in a joint's model. "
        "In brackets: not determined, and yet written, for the part that was kept back is predicted no worse with it. "
        "Per k: for a torque constant of 1 N·m at full PWM. "
        f"Delay {delay}.</p>"
        f"<div class='wide'><table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _by_stops(found: Identification, joint: int) -> list[str]:
    """Two cells: the offset by the end stops, and the difference by weight."""
    stop, weight = 1e3 * found.end_stop_offsets[joint], found.values["offset"]
    apart = "–" if weight.reason[joint] else f"{1e3 * weight.value[joint] - stop:+.1f}"
    return [f"<td class='n'>{stop:.1f}</td>", f"<td class='n'>{apart}</td>"]


def missing_values(found: Identification) -> str:
    """Why values are not determined, and what to record."""
    lines = []
    for name, value in found.values.items():
        for joint, why in enumerate(value.reason):
            if why:
                of = "" if name == "delay" else f" of {_joints(found)[joint]}"
                lines.append(f"<li class='no'>{escape(f'{name}{of}: not determined, because {why}')}</li>")
    return f"<h2>Not determined</h2><ul>{''.join(lines) or '<li>Nothing: all values are.</li>'}</ul>"


def motion_figures(found: Identification) -> str:
    """Measured and simulated motion of the worst, the median and the best joint, from one start, open loop."""
    motion = found.motions[0]
    player = found.fit.player(motion)
    cuts = cut_segments([motion], motion.spec, round(_SHOWN / motion.period))
    middle = slice(len(cuts.position) // 2, len(cuts.position) // 2 + 1)
    pieces = type(cuts.segments)(*(each[middle] for each in cuts.segments))
    simulated = player.play(found.fit.drive, cuts.position[middle], cuts.velocity[middle], pieces)[0]
    before = player.play(found.fit.start, cuts.position[middle], cuts.velocity[middle], pieces)[0]
    measured, t = cuts.measured[middle][0], np.arange(simulated.shape[0]) * motion.period
    order = np.argsort(found.fit.spread.residual)
    cards = []
    for name, joint in (("worst", order[-1]), ("median", order[len(order) // 2]), ("best", order[0])):
        lines = [
            ChartLine(t, measured[:, joint], "ink", "measured"),
            ChartLine(t, before[:, joint], "soft", "after the regression"),
            ChartLine(t, simulated[:, joint], "bad", "simulated"),
        ]
        caption = (
            f"{_joints(found)[joint]}: black measured, red simulated from one start, grey after the regression alone"
        )
        cards.append(figure_card(f"The {name} joint", caption, line_chart(lines, "s", "rad")))
    return f"<h2>Measured and simulated</h2><div class='cards'>{''.join(cards)}</div>"


def spectrum_figures(found: Identification) -> str:
    """Spectrum of the residuals in pieces of 0.3 s, against the noise of the encoders."""
    motion = found.motions[0]
    player = found.fit.player(motion)
    cuts = cut_segments(list(found.motions), motion.spec)
    left = player.play(found.fit.drive, cuts.position, cuts.velocity, cuts.segments) - cuts.measured
    power = np.square(np.abs(np.fft.rfft(left - left.mean(axis=1, keepdims=True), axis=1))).mean(axis=0) / left.shape[1]
    hertz = np.asarray(np.fft.rfftfreq(left.shape[1], motion.period), np.float64)
    cards = []
    for joint in np.argsort(-found.fit.spread.residual)[:3]:
        floor = np.full(len(hertz) - 1, 1e6 * found.fit.floor[joint])
        lines = [
            ChartLine(hertz[1:], 1e6 * np.sqrt(power[1:, joint]), "bad", "left over"),
            ChartLine(hertz[1:], floor, "ink", "noise"),
        ]
        cards.append(
            figure_card(
                _joints(found)[joint], "red left over, black the encoder's noise", line_chart(lines, "Hz", "µrad")
            )
        )
    return (
        "<h2>What is left over</h2><p class='soft'>Simulated minus measured, from smoothed starts; below 10 Hz these "
        f"show, too.</p><div class='cards'>{''.join(cards)}</div>"
    )


def friction_figures(found: Identification) -> str:
    """Torque against speed, and how often each speed occurred."""
    speeds = np.concatenate([smooth_motion(motion).velocity for motion in found.motions])
    cards = []
    for joint, alias in enumerate(_joints(found)):
        v = np.linspace(-1.5, 1.5, 241)
        torque = 1000.0 * _torque(found, joint, v)
        often, edges = np.histogram(speeds[:, joint], bins=60, range=(-1.5, 1.5))
        height = often / often.max() * float(np.abs(torque).max()) if often.any() else often
        lines = [
            ChartLine((edges[1:] + edges[:-1]) / 2.0, height, "soft", "how often"),
            ChartLine(v, torque, "good", "friction and damping"),
        ]
        cards.append(
            figure_card(alias, "blue torque, grey how often each speed was seen", line_chart(lines, "rad/s", "mN·m"))
        )
    return f"<h2>Friction</h2><div class='cards'>{''.join(cards)}</div>"


def spread_tables(found: Identification) -> str:
    """Change by leaving a recording out, and correlated values."""
    rows = []
    for number, motion in enumerate(found.motions):
        moved = found.fit.spread.by_recording[number]
        cells = []
        for name in VALUES:
            own = moved[found.fit.columns(name)]
            cells.append(f"<td class='n'>{_UNITS[name][1] * float(np.median(np.abs(own))):.3g}</td>")
        rows.append(f"<tr><td>{escape(motion.name)}</td>{''.join(cells)}</tr>")
    heads = "".join(
        f"<th class='n'>{escape(name if name not in PER_PWM else name + ', absolute')}</th>" for name in VALUES
    )
    return (
        "<h2>Without one recording</h2><p class='soft'>By how much the median joint's value would change (N·m, g·m², "
        "mN·m·s/rad, mN·m, mrad).</p>"
        f"<div class='wide'><table><thead><tr><th></th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        "<h2>Values that go together</h2><p class='soft'>Torque constant, armature, damping, friction and all masses "
        "times one number give the same motion: that is the scale, which no motion shows. The strongest correlations "
        f"that the data leave, masses held:</p><ul>{''.join(_pairs(found))}</ul>"
    )


def _pairs(found: Identification) -> Iterator[str]:
    names, n = [name for name in NAMES if name != "mass_scale"], len(found.fit.floor)
    columns = np.concatenate([np.arange(n) + found.fit.columns(name).start for name in names])
    labels = [f"{name} of {alias}" for name in names for alias in _joints(found)]
    matrix = np.triu(np.abs(found.fit.spread.correlation[np.ix_(columns, columns)]), 1)
    for place in np.argsort(-matrix, axis=None)[:8]:
        a, b = np.unravel_index(place, matrix.shape)
        value = found.fit.spread.correlation[columns[a], columns[b]]
        yield f"<li>{escape(labels[a])} and {escape(labels[b])}: {value:+.2f}</li>"


def _torque(found: Identification, joint: int, v: Array) -> Array:
    drive = found.fit.drive
    dry = np.full(len(v), drive.frictionloss[joint])
    if found.fit.bristly:
        dry *= 1.0 + (drive.stiction[joint] - 1.0) * np.exp(-np.square(v / drive.stribeck_speed[joint]))
    return np.asarray(np.sign(v) * dry + drive.damping[joint] * v)


def _cell(found: Identification, name: str, joint: int) -> str:
    value, by = found.values[name], _UNITS[name][1]
    guessed = bool(value.reason[joint]) and found.written.guessed(name, joint)
    if value.reason[joint] and not guessed:
        return f"<td class='n' title='{escape(value.reason[joint], quote=True)}'>–</td>"
    if value.absent(joint):
        return "<td class='n' title='not in the model of this joint'>–</td>"
    half = by * value.half[joint]
    digits = int(np.clip(1 - np.floor(np.log10(max(half, 1e-9))), 0, 5))
    text, why = f"{by * value.value[joint]:.{digits}f} ± {half:.{digits}f}", escape(value.reason[joint], quote=True)
    return f"<td class='n' title='{why}'>({text})</td>" if guessed else f"<td class='n'>{text}</td>"


def _play(found: Identification) -> str:
    return "in the model" if found.fit.loose else "none seen"


def _joints(found: Identification) -> tuple[str, ...]:
    spec = found.motions[0].spec
    return spec.joint_labels
