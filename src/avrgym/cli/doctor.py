"""The command ``avrgym doctor``."""

from dataclasses import asdict

import typer

from avrgym.cli.terminal import JsonFileOption, check_json_file, print_line, report_errors, write_json


def doctor(json_file: JsonFileOption = None) -> None:
    """Check this computer, and show how to fix each problem.

    It checks installation, rendering, headset connection and real-time performance. The exit code is 1 if there is an
    error; warnings do not change the exit code.
    """
    from avrgym.doctor.checks import COMPUTER_CHECKS, run_checks
    from avrgym.doctor.finding import Finding

    width = max(len(check.name) for check in COMPUTER_CHECKS)

    def tell(name: str, finding: Finding) -> None:
        print_line(f"{finding.state:8} {name:{width}}  {finding.message}")
        if finding.fix:
            print_line(f"{'':8} {'':{width}}  → {finding.fix}")

    with report_errors():
        check_json_file(json_file)
        found: list[tuple[str, Finding]] = []
        for name, finding in run_checks():
            tell(name, finding)
            found.append((name, finding))
        write_json(json_file, [{"check": name, **asdict(finding)} for name, finding in found])
    states = [finding.state for _, finding in found]
    print_line(f"errors: {states.count('error')}, warnings: {states.count('warning')}")
    if "error" in states:
        raise typer.Exit(1)
