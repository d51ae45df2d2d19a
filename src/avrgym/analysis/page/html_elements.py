"""HTML elements of report pages. A page has no external resources; its layout adapts to the screen width."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

from avrgym.system.files import write_atomically

PAGE_CSS = """
:root { color-scheme: light dark; --ground: #fff; --ink: #1c2024; --faint: #5b6570; --rule: #d5dae0;
  --accent: #0b62a8; --warning: #8a3b00; --warning-ground: #fff1e3;
  --line-1: #0b62a8; --line-2: #b1560f; --line-3: #1b7a43; --line-4: #8b3a8f; --line-5: #6b6b00; --line-6: #b3263a; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171a; --ink: #e6e9ec; --faint: #a0aab4;
  --rule: #363d45; --accent: #6db7f2; --warning: #ffb673; --warning-ground: #35230f;
  --line-1: #6db7f2; --line-2: #f0a35e; --line-3: #6fcf97; --line-4: #d99ae0; --line-5: #cfcf5a; --line-6: #ff8f9c; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 72rem; padding: 1rem; background: var(--ground); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1, h2, h3, h4 { line-height: 1.2; }
article { border-top: 1px solid var(--rule); margin-top: 2.5rem; }
a { color: var(--accent); }
.missing { color: var(--line-6); }
.faint, figcaption, caption { color: var(--faint); }
.notice, .badge { background: var(--warning-ground); color: var(--warning); border-radius: .3rem; }
.notice { padding: .75rem 1rem; }
.badge { display: inline-block; padding: .1rem .5rem; margin: 0 .4rem .4rem 0; font-size: .85rem; }
.scroll { overflow-x: auto; background: linear-gradient(to right, var(--ground) 50%, transparent) left / 2.5rem 100%,
  linear-gradient(to left, var(--ground) 50%, transparent) right / 2.5rem 100%,
  linear-gradient(to right, var(--rule), transparent) left / .7rem 100%,
  linear-gradient(to left, var(--rule), transparent) right / .7rem 100%;
  background-repeat: no-repeat; background-attachment: local, local, scroll, scroll; }
.scroll svg { min-width: 27rem; }
table { border-collapse: collapse; margin: 1rem 0; overflow-wrap: normal; }
caption { text-align: left; padding-bottom: .3rem; max-width: 88vw; }
th, td { padding: .3rem .8rem .3rem 0; border-bottom: 1px solid var(--rule); text-align: left;
  vertical-align: top; }
td.text { min-width: 4.5rem; }
.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
th { vertical-align: bottom; }
@media (max-width: 30rem) { table { font-size: .875rem; } th, td { padding-right: .5rem; } }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(max(8.5rem, 22%), 1fr)); gap: .8rem; }
dt { color: var(--faint); font-size: .85rem; }
dd { margin: 0; font-size: 1.15rem; font-variant-numeric: tabular-nums; }
details { border-top: 1px solid var(--rule); padding: .4rem 0; }
summary { cursor: pointer; }
nav a { margin-right: 1rem; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); gap: 1rem; }
figure { margin: 0; max-width: 40rem; }
figure svg { display: block; width: 100%; height: auto; }
""".strip()


class Markup(str):
    """HTML source code. ``tag`` escapes all texts except those of this type."""


def tag(name: str, *children: Any, **attributes: Any) -> Markup:
    """Returns an HTML element with escaped texts.

    The keyword ``class_`` sets the attribute class, ``aria_label`` sets aria-label.
    """
    content = "".join(child if isinstance(child, Markup) else escape(str(child)) for child in children)
    settings = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value))}"' for key, value in attributes.items()
    )
    return Markup(f"<{name}{settings}>{content}</{name}>")


def join_markup(parts: Sequence[Markup]) -> Markup:
    """Returns the concatenation of HTML elements, without separators."""
    return Markup("".join(parts))


def write_html_page(path: Path, title: str, header: Sequence[Markup], main: Sequence[Markup]) -> Path:
    """Write an HTML page. Creates the folder of the page if it does not exist. Returns ``path``."""
    head = tag("title", title) + tag("style", Markup(PAGE_CSS))
    body = tag("body", tag("header", tag("h1", title), *header), tag("main", *main))
    page = (
        '<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{head}</head>\n{body}\n</html>\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, page.encode())
    return path


def render_warning_box(strong: str, text: str) -> Markup:
    """Returns a paragraph with a warning. It starts with the bold text ``strong``."""
    return tag("p", tag("strong", f"{strong} "), text, class_="notice", role="note")


def render_badge(text: str) -> Markup:
    """Returns an HTML span with the text as a small coloured label."""
    return tag("span", text, class_="badge")


def render_definition_list(metrics: Mapping[str, Any]) -> Markup:
    """Returns an HTML definition list: names and their values."""
    return tag("dl", *(tag("div", tag("dt", name), tag("dd", value)) for name, value in metrics.items()))


def render_bullet_list(items: Sequence[Any]) -> Markup:
    """Returns an HTML list with a bullet for each item."""
    return tag("ul", *(tag("li", item) for item in items))


def render_figure(picture: Markup, caption: str) -> Markup:
    """Returns an HTML figure: an image with its caption."""
    return tag("figure", picture, tag("figcaption", caption))


def render_table(
    caption: str, heads: Sequence[str], rows: Sequence[Sequence[object]], numbers: Sequence[int]
) -> Markup:
    """Returns an HTML table. It scrolls on narrow screens. ``numbers``: indices of the right-aligned columns."""
    kinds = ["number" if column in numbers else "text" for column in range(len(heads))]
    head = [
        tag("th", text, scope="col", class_=kind) if text else tag("td", class_=kind)
        for text, kind in zip(heads, kinds, strict=True)
    ]
    body = [
        tag("tr", *(tag("td", cell, class_=kind) for cell, kind in zip(row, kinds, strict=True)))
        for row in rows
    ]
    whole = tag("table", tag("caption", caption), tag("thead", tag("tr", *head)), tag("tbody", *body))
    return tag("div", whole, class_="scroll", tabindex=0, role="group", aria_label=caption)


def format_short_number(value: float | None) -> str:
    """Returns the number as text with three significant digits; a dash for ``None``."""
    return "–" if value is None else f"{value:z.3g}".replace("-", "−")


def format_number(value: float | None, unit: str = "", digits: int = 2, absent: str = "not recorded") -> str:
    """Returns the number as text with ``digits`` decimals and its unit; ``absent`` for ``None``."""
    return absent if value is None else f"{value:z.{digits}f} {unit}".rstrip().replace("-", "−")


def format_timestamp(at: str | None) -> str:
    """Returns a timestamp (ISO 8601) as text with date, hour and minute; "unknown" for ``None``."""
    return "unknown" if at is None else datetime.fromisoformat(at).strftime("%Y-%m-%d %H:%M")


def format_count(number: int, noun: str) -> str:
    """Returns a number and a noun in singular or plural, such as "2 trials"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_percentage(rate: float | None, low: float | None, high: float | None) -> str:
    """Returns a rate (0 to 1) as a percentage, with its confidence interval if given; a dash for ``None``."""
    if rate is None:
        return "–"
    interval = "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{100 * rate:.0f} %{interval}"


def format_effect_size(effect: float | None, low: float | None, high: float | None) -> str:
    """Returns an effect size as text, with its 95 % confidence interval if given."""
    ends = "" if low is None or high is None else f" [{format_number(low)}, {format_number(high)}]"
    return format_number(effect, absent="–") + ends


def format_p_value(p: float | None) -> str:
    """Returns a p value as text with three decimals; "no test" if ``p`` is ``None``."""
    if p is None:
        return "no test"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def render_details(summary: str, *content: Markup) -> Markup:
    """Returns an HTML details element: the content is hidden until the summary is clicked."""
    return tag("details", tag("summary", summary), *content)


def render_empty_section(title: str, text: str) -> Markup:
    """Returns a report section with a heading and a text instead of results."""
    return tag("section", tag("h3", title), tag("p", text))


def format_group_caption(caption: str, simulated: bool) -> str:
    """Returns the caption. It contains "(simulated participants)" if ``simulated``."""
    return f"{caption} (simulated participants)" if simulated else caption
