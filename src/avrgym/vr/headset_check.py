"""What a check of the headset measured, and whether a session may go on with it: in words, with what to do.

The limits are ours. A display of fewer than 60 Hz flickers; a dropped frame is seen, and one in twenty is more than
people bear for half an hour; hands that tremble by more than the limits seem to be somebody else's.
"""

from collections.abc import Iterator, Mapping, Sequence

import msgspec

from avrgym.texts.interface_texts import ENGLISH, Text
from avrgym.vr.latency import STAGE_WORDS

SLOWEST_DISPLAY_HZ = 60.0
MOST_DROPPED = 0.05
LATEST_MS = 100.0
LEAST_TRACKED = 0.95
MOST_JITTER_MM = {"head": 1.0, "controller": 2.0, "hand": 5.0}
"""By what is tracked; a bare hand is seen by cameras alone."""
LEAST_FRAMES = 30


class TrackedPart(msgspec.Struct, frozen=True):
    """How head or a hand is tracked.

    ``with_``: a ``headset``, a ``controller``, the bare ``hand``, a ``mouse``, or ``none``. ``share`` of the frames in
    which it was tracked. ``jitter_mm``: how far it strays at rest from parabolas through half a second, root mean
    square. ``reach_m``: how far from the head a hand was tracked.
    """

    with_: str = msgspec.field(name="with")
    share: float
    jitter_mm: float | None = None
    reach_m: float | None = None


class HeadsetCheck(msgspec.Struct, frozen=True):
    """The figures of a check.

    ``device`` is the device that the browser reports, ``profiles`` its controllers; ``emulated``: there was no
    headset. ``display_hz`` is ``None`` if the headset does not report it. ``seconds`` were measured, in which so many
    ``frames`` were drawn, at ``frame_rate_hz`` and with ``dropped_share`` missing. ``latency_ms``: percentiles by stage
    as of ``vr.latency``. ``haptics`` and ``sound``: the participant felt and heard them; ``None`` where nobody
    asked.
    ``stop``: how the participant tried the stop, ``none`` where they did not; ``None`` where nobody asked them to.
    ``stop_after_s``: the time from the request to the stop; ``None`` where there was no stop.
    """

    device: str
    emulated: bool
    profiles: list[str]
    display_hz: float | None
    seconds: float
    frames: int
    frame_rate_hz: float
    dropped_share: float
    latency_ms: Mapping[str, Mapping[str, float]]
    head: TrackedPart
    left: TrackedPart
    right: TrackedPart
    haptics: bool | None = None
    sound: bool | None = None
    stop: str | None = None
    stop_after_s: float | None = None

    @property
    def go(self) -> bool:
        """Whether a session may begin."""
        return not self.faults()

    def faults(self) -> list[Text]:
        """What keeps a session from beginning, each with what to do."""
        of_parts = (_frame_faults, _latency_faults, _tracking_faults, _sense_faults, _stop_faults)
        return [fault for faults in of_parts for fault in faults(self)]

    def verdict(self, most: int) -> Text:
        """What the participant reads: whether they can go on, or so many faults at most and how many more there are."""
        faults = self.faults()
        if not faults:
            return Text("headset_ready")
        told = _in_a_row(faults[:most])
        if len(faults) > most:
            told = Text("more_faults", {"faults": told, "more": str(len(faults) - most)})
        return Text("headset_not_ready", {"faults": told})

    def words(self) -> str:
        """Go or no-go, with all faults, for experimenters."""
        return f"No-go. {self.fault_words}" if self.faults() else "Go: the headset is ready."

    @property
    def fault_words(self) -> str:
        """All faults, in English."""
        return " ".join(ENGLISH.render(fault) for fault in self.faults())

    def figures(self) -> str:
        """All that was measured, in one line."""
        total = self.latency_ms.get("total_ms")
        return "; ".join(
            [
                f"{self.frame_rate_hz:.0f} frames a second" + _of_display(self.display_hz),
                f"{100.0 * self.dropped_share:.1f} % dropped",
                "latency not measured"
                if total is None
                else f"pose to picture {total['p50']:.0f} ms, 95 % within {total['p95']:.0f} ({_stages(self)})",
                *(_part_words(name, part) for name, part in _parts(self)),
                f"buzz {_felt(self.haptics, 'felt')}, chime {_felt(self.sound, 'heard')}",
                *([] if self.stop is None else [f"stop tried with: {self.stop}{_after(self.stop_after_s)}"]),
            ]
        )


def _after(seconds: float | None) -> str:
    return "" if seconds is None else f" after {seconds:.1f} s"


def _in_a_row(said: Sequence[Text]) -> Text:
    first, *rest = said
    return Text("one_after_another", {"first": first, "rest": _in_a_row(rest)}) if rest else first


def _of_display(display_hz: float | None) -> str:
    return "" if display_hz is None else f" of {display_hz:.0f}"


def _stages(check: HeadsetCheck) -> str:
    return ", ".join(f"{words} {check.latency_ms[stage]['p50']:.0f}" for stage, words in STAGE_WORDS.items())


def _felt(answer: bool | None, verb: str) -> str:
    return "not asked" if answer is None else verb if answer else f"not {verb}"


def _parts(check: HeadsetCheck) -> tuple[tuple[str, TrackedPart], ...]:
    return ("head", check.head), ("left hand", check.left), ("right hand", check.right)


def _part_words(name: str, part: TrackedPart) -> str:
    jitter = "" if part.jitter_mm is None else f", jitter {part.jitter_mm:.2f} mm"
    reach = "" if part.reach_m is None else f", reach {part.reach_m:.2f} m"
    return f"{name} ({part.with_}) tracked {100.0 * part.share:.0f} %{jitter}{reach}"


def _frame_faults(check: HeadsetCheck) -> Iterator[Text]:
    if check.frames < LEAST_FRAMES:
        yield Text("fault_no_pictures")
        return
    display_hz = check.display_hz or check.frame_rate_hz
    if display_hz < SLOWEST_DISPLAY_HZ:
        yield Text("fault_display", {"hz": f"{display_hz:.0f}", "least_hz": f"{SLOWEST_DISPLAY_HZ:.0f}"})
    if check.dropped_share > MOST_DROPPED:
        shares = {"percent": check.dropped_share, "most_percent": MOST_DROPPED}
        yield Text("fault_dropped", {name: f"{100.0 * share:.0f}" for name, share in shares.items()})


def _latency_faults(check: HeadsetCheck) -> Iterator[Text]:
    total = check.latency_ms.get("total_ms")
    if total is None:
        yield Text("fault_no_answer")
    elif total["p95"] > LATEST_MS:
        slowest = max(STAGE_WORDS, key=lambda stage: check.latency_ms[stage]["p95"])
        values = {"ms": f"{total['p95']:.0f}", "most_ms": f"{LATEST_MS:.0f}"}
        yield Text("fault_late", values | {"advice": Text(f"advice_{slowest.removesuffix('_ms')}")})


def _tracking_faults(check: HeadsetCheck) -> Iterator[Text]:
    for name, part in _parts(check):
        tracked = {"part": Text(f"part_{name.replace(' ', '_')}")}
        if part.with_ == "mouse":
            yield Text("fault_mouse", tracked)
            continue
        if part.share < LEAST_TRACKED:
            shares = {"percent": f"{100.0 * part.share:.0f}", "least_percent": f"{100.0 * LEAST_TRACKED:.0f}"}
            yield Text("fault_untracked", tracked | shares)
        limit_mm = MOST_JITTER_MM.get("head" if name == "head" else part.with_)
        if limit_mm is not None and part.jitter_mm is not None and part.jitter_mm > limit_mm:
            yield Text("fault_jitter", tracked | {"mm": f"{part.jitter_mm:.1f}", "most_mm": f"{limit_mm:g}"})


def _sense_faults(check: HeadsetCheck) -> Iterator[Text]:
    if check.haptics is False:
        yield Text("fault_haptics")
    if check.sound is False:
        yield Text("fault_sound")


def _stop_faults(check: HeadsetCheck) -> Iterator[Text]:
    if check.stop == "none":
        yield Text("fault_no_stop")
