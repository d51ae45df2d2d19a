"""Draw all figures of a study."""

from avrgym.analysis.answers.figures import (
    mean_answer_figures,
    session_answer_figures,
    trial_answer_figures,
)
from avrgym.analysis.biomechanics.figures import head_position_figure, torso_height_figure
from avrgym.analysis.outcomes.figures import reward_figure, success_figure
from avrgym.analysis.page.drawing import ReportFigure
from avrgym.analysis.study import StudyAnalysis


def draw_figures(analysis: StudyAnalysis) -> list[ReportFigure]:
    """Returns all figures that have data. For each kind: the figure of people, then of simulated participants."""
    drawings: list[ReportFigure] = []
    for simulated in sorted({row.simulated for row in analysis.objective_outcomes}):
        drawings += [
            success_figure(analysis.design, simulated, analysis.objective_outcomes),
            reward_figure(analysis.design, simulated, analysis.objective_outcomes),
        ]
    for simulated in sorted({row.simulated for row in analysis.answer_frequencies}):
        own = [row for row in analysis.answer_frequencies if row.simulated is simulated]
        tests = [row for row in analysis.tests if row.simulated is simulated]
        drawings += trial_answer_figures(analysis.design, simulated, own, tests)
        drawings += session_answer_figures(analysis.design, simulated, own, tests)
        drawings += mean_answer_figures(analysis.design, simulated, analysis.answer_summaries, tests)
    for group in analysis.body_trials:
        drawings.append(torso_height_figure(group, analysis.training_people))
        drawings.append(head_position_figure(group, analysis.training_people))
    return drawings
