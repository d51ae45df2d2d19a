"""The commands ``avrgym analyze`` and ``avrgym fit-reward``."""

from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)
from avrgym.study.storage.analysis_files import ANALYSIS_FOLDER


def analyze(
    folder: Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")],
    out: Annotated[
        Path | None, typer.Option(help="A folder for the analysis; default: a folder in the study's folder.")
    ] = None,
    skip_damaged: Annotated[
        bool,
        typer.Option("--skip-damaged", help="Ignore damaged recordings; the report lists them."),
    ] = False,
    json_file: JsonFileOption = None,
) -> None:
    """Analyse a study: report, tables, figures and results.

    An earlier analysis in the same folder is replaced.
    """
    from avrgym.analysis.output_files import check_output_folder, write_analysis
    from avrgym.analysis.study_analysis import analyse_study
    from avrgym.study.storage.store import StudyStore

    place = out or folder / ANALYSIS_FOLDER
    with report_errors(), StudyStore(folder) as store:
        check_json_file(json_file)
        check_output_folder(place)
        with show_progress_bar("reading recordings", unit="recordings") as bar:
            analysis = analyse_study(store, bar.update, skip_damaged=skip_damaged)
        log_command(store, "analyze", shows_results=True)
        with show_progress_bar("writing tables, figures and report"):
            report = write_analysis(analysis, folder, place)
        write_json(json_file, analysis.make_results())
    print_line(f"report    {report}")
    if problems := len(analysis.study_data.problems) + len(analysis.design_differences):
        print_line(f"problems: {problems}; the report lists each")


def fit_reward(
    folder: Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")],
    out: Annotated[Path, typer.Option(help="A new JSON file for the reward weights.", metavar="FILE")] = Path(
        "reward.json"
    ),
    item: Annotated[
        list[str] | None,
        typer.Option(
            help="An item for the sum of answers; default: L2 (comfort) and L3 (safety). Repeatable."
        ),
    ] = None,
) -> None:
    """Fit reward weights to the answers after a study's trials.

    In a comparison of two trials, the trial with the higher sum of answers is preferred. The accuracy for each
    participant is computed with weights that are fitted to all other participants.
    """
    from avrgym.analysis.reward_model import COMFORT_ITEM_NAMES, fit_reward_models, write_reward_models
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        models = fit_reward_models(store, item or COMFORT_ITEM_NAMES)
        log_command(store, "fit-reward", shows_results=True)
        write_reward_models(models, out)
        columns = ("task", "participants", "comparisons", "accuracy", "accuracy_of_reward", "simulated")
        print_table([{name: getattr(model, name) for name in columns} for model in models])
    print_line(f"weights   {out}")
