"""The program ``avrgym``."""

from avrgym.cli.analysis import analyze, fit_reward
from avrgym.cli.bench import app as bench_commands
from avrgym.cli.clone import clone
from avrgym.cli.demo import demo
from avrgym.cli.demonstrate import demonstrate
from avrgym.cli.doctor import doctor
from avrgym.cli.evaluation import envs, evaluate, fit_people
from avrgym.cli.export import app as export_commands
from avrgym.cli.host import host
from avrgym.cli.new_package import app as new_commands
from avrgym.cli.program import CommandGroup, Program
from avrgym.cli.replay import replay
from avrgym.cli.serve import serve, view
from avrgym.cli.study import app as study_commands
from avrgym.cli.sweep import sweep
from avrgym.cli.terminal import report_errors
from avrgym.cli.training import train
from avrgym.system.mujoco_setup import check_rendering_backend

app = Program(
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Real people meet simulated assistive robots in virtual reality.",
)


@app.callback()
def prepare_command() -> None:
    """Check the rendering backend of MuJoCo before every command."""
    with report_errors():
        check_rendering_backend()


app.add_typer(bench_commands, name="bench")
app.add_typer(study_commands, name="study")
app.add_typer(new_commands, name="new")
app.add_typer(export_commands, name="export")
for command in (
    demo,
    serve,
    host,
    view,
    demonstrate,
    envs,
    train,
    clone,
    sweep,
    evaluate,
    fit_people,
    fit_reward,
    replay,
    analyze,
    doctor,
):
    app.command()(command)
