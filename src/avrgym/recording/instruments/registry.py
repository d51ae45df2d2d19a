"""Every validated questionnaire that ``use`` in ``study.toml`` may name."""

from collections.abc import Mapping

from avrgym.recording.instruments.experience import IPQ, SUS
from avrgym.recording.instruments.instrument import Instrument
from avrgym.recording.instruments.robots import GODSPEED, JIAN_TRUST, ROSAS
from avrgym.recording.instruments.sickness import CSQ_VR, SSQ
from avrgym.recording.instruments.workload import NASA_TLX, NASA_TLX_WEIGHTS

INSTRUMENTS: Mapping[str, Instrument] = {
    instrument.name: instrument
    for instrument in (NASA_TLX, NASA_TLX_WEIGHTS, SSQ, CSQ_VR, IPQ, SUS, ROSAS, GODSPEED, JIAN_TRUST)
}
