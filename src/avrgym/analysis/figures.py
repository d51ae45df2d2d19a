"""Draw all figures of a study."""

from avrgym.analysis.answers.figures import (
    draw_mean_answer_figures,
    draw_session_answer_figures,
    draw_trial_answer_figures,
)
from avrgym.analysis.biomechanics.figures import draw_head_position_figure, draw_torso_height_figure
from avrgym.analysis.outcomes.figures import draw_reward_figure, draw_success_figure
from avrgym.analysis.page.report_figures import ReportFigure
from avrgym.analysis.study_analysis import StudyAnalysis


def draw_figures(analysis: StudyAnalysis) -> list[ReportFigure]:
    """Returns all figures that have data. For each kind: the figure of people, then of simulated participants."""
    drawings: list[ReportFigure] = []
    for simulated in sorted({row.simulated for row in analysis.objective_outcomes}):
        drawings += [
            draw_success_figure(analysis.design, simulated, analysis.objective_outcomes),
            draw_reward_figure(analysis.design, simulated, analysis.objective_outcomes),
        ]
    for simulated in sorted({row.simulated for row in analysis.answer_frequencies}):
        own = [row for row in analysis.answer_frequencies if row.simulated is simulated]
        tests = [row for row in analysis.tests if row.simulated is simulated]
        drawings += draw_trial_answer_figures(analysis.design, simulated, own, tests)
        drawings += draw_session_answer_figures(analysis.design, simulated, own, tests)
        drawings += draw_mean_answer_figures(analysis.design, simulated, analysis.answer_summaries, tests)
    for group in analysis.posture_trials:
        drawings.append(draw_torso_height_figure(group, analysis.training_people))
        drawings.append(draw_head_position_figure(group, analysis.training_people))
    return drawings
