"""Write the files for a publication: methods section, tables, checklist and codebook."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from avrgym.analysis.page.html_elements import (
    Markup,
    join_markup,
    render_badge,
    render_figure,
    render_table,
    render_warning_box,
    tag,
    write_html_page,
)
from avrgym.analysis.participant_flow import ParticipantFlow, draw_flow_chart
from avrgym.analysis.publication.checklist import ChecklistField, make_checklist_fields
from avrgym.analysis.publication.codebook import make_codebook_rows, make_data_package, make_json_schema
from avrgym.analysis.publication.methods import (
    SIMULATED_DATA_TEXT,
    MethodsSections,
    format_methods_markdown,
    make_methods_sections,
    select_publication_flow,
)
from avrgym.analysis.publication.publication_tables import (
    PublicationTable,
    format_latex_table,
    make_publication_tables,
)
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.table_files import write_csv

PUBLICATION_FOLDER = "reporting"
PAGE_FILE = "index.html"
DATA_PACKAGE_FILE = "datapackage.json"
PLACEHOLDER_PATTERN = re.compile(r"(\[MISSING: [^\]]*\])")
NO_PARTICIPANTS_TEXT = "The study has no participants yet; there is nothing to report."
FILES_TEXT = (
    "In this folder: methods.md, the same text; flow-*.svg and flow-*.pdf; *.tex, the tables for LaTeX with the "
    "package booktabs (the tables below can be pasted into Word); codebook.csv and schema.json on every column of the "
    "tables of the analysis, which tables/datapackage.json describes for Frictionless; checklist.csv."
)


def write_publication_files(analysis: StudyAnalysis, folder: Path, tables: Path) -> None:
    """Write the publication files into the new ``folder``. Write ``datapackage.json`` into the folder ``tables``."""
    folder.mkdir()
    _write_codebook(analysis, folder, tables)
    flow = select_publication_flow(analysis)
    if flow is None:
        write_html_page(folder / PAGE_FILE, _title(analysis), [], [tag("p", NO_PARTICIPANTS_TEXT)])
        return
    sections, asked = make_methods_sections(analysis, flow), make_checklist_fields(analysis, flow)
    (folder / "methods.md").write_text(
        format_methods_markdown(analysis.design.title, sections), encoding="utf-8"
    )
    write_csv(folder / "checklist.csv", (_checked(each) for each in asked))
    shown: list[PublicationTable] = []
    for each in analysis.participant_flows:
        group = "simulated" if each.is_simulated else "people"
        draw_flow_chart(each).write(folder)
        for own in make_publication_tables(analysis, each.is_simulated):
            text = format_latex_table(own.caption, own.column_headings, own.rows, own.numeric_columns)
            (folder / f"{own.name}-{group}.tex").write_text(text, encoding="utf-8")
            shown.append(own)
    write_html_page(
        folder / PAGE_FILE, _title(analysis), _header(analysis), _main(analysis, sections, asked, shown)
    )


def _write_codebook(analysis: StudyAnalysis, folder: Path, tables: Path) -> None:
    every, title = list(analysis.make_tables()), analysis.design.title
    write_csv(folder / "codebook.csv", make_codebook_rows(every))
    for path, content in (
        (folder / "schema.json", make_json_schema(every, title)),
        (tables / DATA_PACKAGE_FILE, make_data_package(every, title, PRIVACY_NOTICE)),
    ):
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _title(analysis: StudyAnalysis) -> str:
    return f"{analysis.design.title}: reporting"


def _header(analysis: StudyAnalysis) -> list[Markup]:
    simulated = any(flow.is_simulated for flow in analysis.participant_flows)
    about = "Results of simulated participants are marked and never combined with those of people."
    return [
        *([render_warning_box("SIMULATED PARTICIPANTS.", about)] if simulated else []),
        tag("p", FILES_TEXT),
        tag("p", tag("a", "The report", href="../report/index.html")),
    ]


def _main(
    analysis: StudyAnalysis,
    sections: MethodsSections,
    asked: Sequence[ChecklistField],
    shown: Sequence[PublicationTable],
) -> list[Markup]:
    return [
        tag("section", tag("h2", "Methods"), *_methods(sections), id="methods"),
        tag("section", tag("h2", "Flow of participants"), *map(_flow, analysis.participant_flows), id="flow"),
        tag("section", tag("h2", "Checklist of reporting recommendations"), _asked(asked), id="checklist"),
        tag(
            "section",
            tag("h2", "Tables"),
            *(
                render_table(each.caption, each.column_headings, each.rows, each.numeric_columns)
                for each in shown
            ),
            id="tables",
        ),
    ]


def _methods(sections: MethodsSections) -> list[Markup]:
    parts: list[Markup] = []
    for heading, paragraphs in sections.items():
        parts += [tag("h3", heading)] if heading else []
        parts += [_paragraph(text) for text in paragraphs]
    return parts


def _paragraph(text: str) -> Markup:
    if text == SIMULATED_DATA_TEXT:
        return render_badge(text)
    pieces = PLACEHOLDER_PATTERN.split(text)
    return tag("p", *(_missing(piece) if number % 2 else piece for number, piece in enumerate(pieces)))


def _missing(text: str) -> Markup:
    return tag("strong", text, class_="missing")


def _flow(flow: ParticipantFlow) -> Markup:
    drawing = draw_flow_chart(flow)
    return render_figure(drawing.to_inline_svg(), drawing.caption)


def _asked(asked: Sequence[ChecklistField]) -> Markup:
    lacking = sum(not each.value for each in asked)
    rows = [
        (each.field, each.value or _missing("missing"), "" if each.value else each.source) for each in asked
    ]
    words = f"{lacking} of {len(asked)} fields are missing." if lacking else "No field is missing."
    shown = render_table(
        "Recommended fields of a publication", ("Field", "Value", "Source"), rows, numbers=()
    )
    return join_markup([tag("p", words), shown])


def _checked(asked: ChecklistField) -> dict[str, object]:
    return {"field": asked.field, "missing": not asked.value, "value": asked.value, "source": asked.source}
