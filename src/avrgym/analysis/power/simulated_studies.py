"""Simulate the answers of participants in a study, with assumed effects of policies."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from avrgym.analysis.answers.trial_answers import AFTER_TRIAL, find_questionnaires_at_moment
from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.questionnaires.questionnaire import Item
from avrgym.study.design.allocation import find_least_used_order_index, make_trial_orders
from avrgym.study.design.counterbalancing import TrialOrder
from avrgym.study.design.design import Design
from avrgym.system import random_streams

SimulatedAnswers = NDArray[np.int_]
"""Answers (participants, tasks, robots, policies, items) of the participants who completed the study."""
REFERENCE_SCALE_POINTS = 7
"""Number of points of the reference scale. Effects and standard deviations are in points of this scale; values for
other scales are proportional to their length."""


@dataclass(frozen=True)
class PowerAssumptions:
    """Assumed variation of answers. Standard deviations are in points of a seven-point scale.

    ``participant_sd``: differences between participants in mean rating. ``policy_sd``: differences between participants
    in the policy effect. ``task_sd``: differences between tasks, equal for all participants. ``noise_sd``: residual.
    ``drift``: increase of the mean rating from the first to the last trial of a session, in points. ``dropout``: share
    of participants who withdraw and are replaced.

    The default values are not measured. They result in a standard deviation of answers of about 1.5 points.
    """

    participant_sd: float = 0.8
    policy_sd: float = 0.5
    task_sd: float = 0.5
    noise_sd: float = 1.0
    drift: float = 0.5
    dropout: float = 0.1

    def __post_init__(self) -> None:
        """Raises ``ValueError`` if a value is out of range."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value) or (value < 0 and field.name != "drift"):
                allowed = "any finite number" if field.name == "drift" else "0 or more"
                raise ValueError(f"{field.name} is {value:g}; allowed: {allowed}")
        if self.dropout >= 1:
            raise ValueError(f"dropout is {self.dropout:g}; allowed: 0 or more, below 1")


def compute_scale_midpoint(item: Item) -> float:
    """Returns the midpoint of the scale of an item. In these simulations, each scale starts at 1."""
    return (1 + item.points) / 2


class SimulatedStudies:
    """Generates simulated studies of one design. ``number`` is the index of a study.

    Study ``number`` has the same random values for each effect size. A larger study contains the participants of a
    smaller study with the same ``number``.
    """

    def __init__(self, design: Design, assumptions: PowerAssumptions, seed: int) -> None:
        """Store the parameters. Raises ``ValueError`` if the design has no questionnaire after trials."""
        asked = find_questionnaires_at_moment(design, AFTER_TRIAL)
        if not asked:
            raise ValueError(
                "the design has no questionnaire after trials; add one to study.toml to simulate its answers"
            )
        self.design, self.questionnaire = design, asked[0]
        self._assumptions, self._seed = assumptions, seed
        self._shape = (len(design.tasks), len(design.robots), len(design.policies), len(asked[0].items))
        self._places = self._places_in_session()
        self._middle = np.array([compute_scale_midpoint(item) for item in asked[0].items])
        self._points = np.array([item.points for item in asked[0].items])

    def simulate_answers(self, effect: float, participants: int, number: int) -> SimulatedAnswers:
        """Returns the answers of the participants who complete study ``number``.

        Without random variation and drift, the ratings of the last policy are ``effect`` points above the midpoint. The
        ratings of all other policies are at the midpoint.
        """
        assumed, (tasks, _, policies, _) = self._assumptions, self._shape
        rng = random_streams.make_simulated_study_rng(self._seed, number, 0)
        stays, cells = self._session(participants, number)
        places = self._places[cells]
        drawn = rng.standard_normal((len(stays), 1 + policies + int(np.prod(self._shape))))
        lenience, liking = drawn[:, 0], drawn[:, 1 : 1 + policies]
        noise = drawn[:, 1 + policies :].reshape(-1, *self._shape)
        of_task = random_streams.make_simulated_study_rng(self._seed, number, 1).standard_normal(tasks)
        of_policy = np.where(np.arange(policies) == policies - 1, effect, 0.0)
        shift = (
            assumed.participant_sd * lenience[:, None, None, None]
            + assumed.policy_sd * liking[:, None, None, :]
            + assumed.task_sd * (of_task - of_task.mean())[:, None, None]
            + assumed.drift * (places - 0.5)
            + of_policy
        )
        latent = shift[..., None] + assumed.noise_sd * noise
        rated = np.rint(self._middle + latent * (self._points - 1) / (REFERENCE_SCALE_POINTS - 1))
        return np.clip(rated, 1, self._points).astype(int)[stays]

    def simulate_trial_orders(self, participants: int, number: int) -> list[TrialOrder]:
        """Returns the order of trials of each participant who completes study ``number``."""
        stays, cells = self._session(participants, number)
        orders = make_trial_orders(self.design)
        return [orders[cell] for cell in cells[stays]]

    def simulate_objective_measures(self, participants: int, number: int) -> FloatArray:
        """Returns random success, reward and force (participants, policies, 3). They do not depend on the policy."""
        rng = random_streams.make_simulated_study_rng(self._seed, number, 3)
        return rng.standard_normal((participants, self._shape[2], 3))

    def _session(self, participants: int, number: int) -> tuple[BoolArray, IntArray]:
        """Simulate enrolment and dropout until ``participants`` participants have completed the study.

        Orders are assigned as in a real study: the order of a withdrawn participant is assigned again.

        Returns:
            Boolean mask (m,) of participants who complete the study, and the indices (m,) of their orders.
        """
        rng = random_streams.make_simulated_study_rng(self._seed, number, 2)
        stays: list[bool] = []
        cells: list[int] = []
        while sum(stays) < participants:
            taken = [cell for cell, remains in zip(cells, stays, strict=True) if remains]
            cells.append(find_least_used_order_index(range(len(self._places)), taken))
            stays.append(bool(rng.random() >= self._assumptions.dropout))
        return np.array(stays), np.array(cells)

    def _places_in_session(self) -> FloatArray:
        """Returns the position (0 to 1) of each condition in the session: (orders, tasks, robots, policies)."""
        tasks, robots, policies, _ = self._shape
        orders = make_trial_orders(self.design)
        places = np.zeros((len(orders), tasks, robots * policies))
        for cell, order in enumerate(orders):
            met = [(block.task_index, condition) for block in order for condition in block.condition_indices]
            for position, (task, condition) in enumerate(met):
                places[cell, task, condition] = position / max(len(met) - 1, 1)
        return places.reshape(-1, tasks, robots, policies)
