"""A recording as a data frame, and a plot of it: ``python 07_recording_to_data_frame.py RECORDING.mcap``

Needs pandas. Writes ``trial.png``. ``my-study/recordings`` of the example before contains recordings.
"""

import sys

import matplotlib.pyplot as plt
import msgspec
import pandas as pd

from avrgym.recording.reader import read_recording

recording = read_recording(sys.argv[1])
print(f"{recording.configuration.environment}, policy {recording.configuration.policy}, {recording.result}")


def frame(topic: str) -> pd.DataFrame:
    """The records of a topic, one row each, by time in seconds."""
    times_ns, records = zip(*recording.messages_by_topic[topic], strict=True)
    index = pd.Index([time_ns / 1e9 for time_ns in times_ns], name="time_s")
    return pd.DataFrame([msgspec.to_builtins(record) for record in records], index=index)


control, events = frame("/control"), frame("/events")
terms = pd.DataFrame(control["reward_terms"].tolist(), index=control.index)
print(control[["reward", "distance_m", "force_on_person_n", "success"]].describe(include="all"))
print(terms.sum().round(2).to_string())

figure, (above, middle, below) = plt.subplots(3, sharex=True, figsize=(7, 6), layout="constrained")
above.plot(control.index, control["reward"].cumsum())
above.set_ylabel("reward so far")
middle.plot(control.index, control["distance_m"])
middle.set_ylabel("distance, m")
below.plot(control.index, control["force_on_person_n"])
below.set(xlabel="time, s", ylabel="force, N")
for time_s in events.index[events["name"] == "phase"]:
    for axes in (above, middle, below):
        axes.axvline(time_s, color="0.85", zorder=0)
figure.savefig("trial.png", dpi=150)
