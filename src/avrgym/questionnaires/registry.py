"""The validated questionnaires by their names in ``study.toml``."""

from collections.abc import Mapping

from avrgym.questionnaires.csq_vr import CSQ_VR
from avrgym.questionnaires.godspeed import GODSPEED
from avrgym.questionnaires.instrument import Instrument
from avrgym.questionnaires.ipq import IPQ
from avrgym.questionnaires.jian_trust import JIAN_TRUST
from avrgym.questionnaires.nasa_tlx import NASA_TLX, NASA_TLX_WEIGHTS
from avrgym.questionnaires.rosas import ROSAS
from avrgym.questionnaires.ssq import SSQ
from avrgym.questionnaires.sus import SUS

INSTRUMENTS: Mapping[str, Instrument] = {
    instrument.name: instrument
    for instrument in (NASA_TLX, NASA_TLX_WEIGHTS, SSQ, CSQ_VR, IPQ, SUS, ROSAS, GODSPEED, JIAN_TRUST)
}
