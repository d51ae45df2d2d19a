"""Sessions of a hosted study over emulated networks: round trips, tracking loss and completed trials.

Prints a table: ``python tests/soak/soak_networks.py``.
"""

import asyncio
import json
import multiprocessing
import sys
import tempfile
from pathlib import Path
from statistics import fmean
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from avrgym.hosting.host import StudyHost
from avrgym.recording.reader import read_recording
from avrgym.study.checking.tracking_loss import compute_tracking_loss_fraction
from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.store import StudyStore
from helpers.hosting.emulated_participants import EmulatedParticipant, percentile_ms, record_motion
from helpers.hosting.network_emulation import EmulatedNetwork, Network
from helpers.studies.small_studies import make_study

DESIGN = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "trial_steps": "60", "free_movement_s": "1.0"}
AT_ONCE = 2
DEADLINE_S = 240.0
NETWORKS = {
    "loopback": Network(),
    "20 ms": Network(20.0),
    "60 ms": Network(60.0),
    "120 ms": Network(120.0),
    "60 ms, jitter 5 ms": Network(60.0, 5.0),
    "60 ms, jitter 20 ms": Network(60.0, 20.0),
    "60 ms, loss 1 %": Network(60.0, loss=0.01),
    "60 ms, loss 3 %": Network(60.0, loss=0.03),
    "60 ms, 2 Mbit/s": Network(60.0, rate_mbit=2.0),
    "60 ms, 10 Mbit/s": Network(60.0, rate_mbit=10.0),
    "60 ms, stall of 3 s": Network(60.0, stall_at_s=9.0),
    "60 ms, changed address": Network(60.0, drop_at_s=9.0),
}


def test_trials_count_on_a_network_of_60_ms(tmp_path: Path) -> None:
    (row,) = measure(tmp_path / "study", {"60 ms": NETWORKS["60 ms"]})
    print(row)
    assert (row["ending"], row["trials"]) == ("completed", 3)


def measure(folder: Path, networks: dict[str, Network]) -> list[dict[str, Any]]:
    """Let one participant take part over each network. Returns a row for each."""
    make_study(folder, **DESIGN)
    (folder / "host.toml").write_text("headset_check = false\nabsence_minutes = 1\n")
    with StudyStore(folder) as store, StudyHost(store, max_sessions=AT_ONCE) as host:
        invitations = create_invitations(store, [""] * len(networks), days=1)
        tokens = [each.token for each in invitations]
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rows = pool.apply(_take_part, (host.public_port, tokens, networks))
        pseudonyms = {row["number"]: each for row, each in zip(rows, _by_invitation(store), strict=True)}
        return [row | _stored(store, pseudonyms[row["number"]]) for row in rows]


def _by_invitation(store: StudyStore) -> list[str]:
    from avrgym.study.storage.database_rows import InvitationUse, format_pseudonym
    from avrgym.study.storage.store import find_rows

    with store.database.read_transaction() as connection:
        uses = sorted(find_rows(connection, InvitationUse), key=lambda each: each.invitation)
    return [format_pseudonym(each.participant or 0) for each in uses]


def _stored(store: StudyStore, pseudonym: str) -> dict[str, Any]:
    attempts = store.read_attempts(pseudonym)
    shares = [
        share
        for each in attempts
        if each.state == "completed"
        and (share := compute_tracking_loss_fraction(read_recording(store.resolve_path(each.recording))))
        is not None
    ]
    return {
        "trials": sum(each.state == "completed" for each in store.read_trials(pseudonym)),
        "interrupted": sum(each.state == "interrupted" for each in attempts),
        "tracking_lost_percent": round(100.0 * fmean(shares), 2) if shares else None,
    }


def _take_part(port: int, tokens: list[str], networks: dict[str, Network]) -> list[dict[str, Any]]:
    return asyncio.run(_together(port, tokens, networks))


async def _together(port: int, tokens: list[str], networks: dict[str, Network]) -> list[dict[str, Any]]:
    motion, free = record_motion(), asyncio.Semaphore(AT_ONCE)

    async def one(number: int, name: str, network: Network, token: str) -> dict[str, Any]:
        async with free, EmulatedNetwork(network, port) as emulated:
            person = EmulatedParticipant(f"http://localhost:{emulated.port}", token, motion, 37 * number)
            person.host = f"localhost:{port}"
            outcome = await person.take_part(DEADLINE_S)
        percentiles = {
            f"p{round(100 * p)}_ms": round(percentile_ms([outcome], p), 1) for p in (0.5, 0.95, 0.99)
        }
        return {
            "number": number,
            "network": name,
            **percentiles,
            "connections": outcome.connections,
            "ending": outcome.ending,
            "error": outcome.error,
        }

    each = zip(networks.items(), tokens, strict=True)
    return list(
        await asyncio.gather(
            *(one(i, name, network, token) for i, ((name, network), token) in enumerate(each))
        )
    )


if __name__ == "__main__":
    wanted = {name: NETWORKS[name] for name in sys.argv[1:] or NETWORKS}
    with tempfile.TemporaryDirectory() as temporary:
        for line in measure(Path(temporary) / "study", wanted):
            print(json.dumps(line), flush=True)
