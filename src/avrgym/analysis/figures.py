"""Draw all figures of a study."""

from avrgym.analysis.answers.figures import (
    mean_answers_figures,
    session_answers_figures,
    trial_answers_figures,
)
from avrgym.analysis.biomechanics.figures import head_position_figure, torso_height_figure
from avrgym.analysis.outcomes.figures import reward_figure, success_figure
from avrgym.analysis.page.drawing import Drawing
from avrgym.analysis.study import Analysis


def draw_figures(analysis: Analysis) -> list[Drawing]:
    """Returns all figures that have data. In each kind of figure, people are before simulated participants."""
    drawings: list[Drawing] = []
    for simulated in sorted({row.simulated for row in analysis.objective}):
        drawings += [
            success_figure(analysis.design, simulated, analysis.objective),
            reward_figure(analysis.design, simulated, analysis.objective),
        ]
    for simulated in sorted({row.simulated for row in analysis.likert}):
        own = [row for row in analysis.likert if row.simulated is simulated]
        tests = [row for row in analysis.tests if row.simulated is simulated]
        drawings += trial_answers_figures(analysis.design, simulated, own, tests)
        drawings += session_answers_figures(analysis.design, simulated, own, tests)
        drawings += mean_answers_figures(analysis.design, simulated, analysis.subjective, tests)
    for group in analysis.groups:
        drawings.append(torso_height_figure(group, analysis.people))
        drawings.append(head_position_figure(group, analysis.people))
    return drawings
