"""Parts of a report page: one HTML file with its tables and pictures inside."""

import base64
import html
import io
from collections.abc import Sequence
from typing import Any

STYLE = """body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .8em;text-align:right;
border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}
img{max-width:100%}.verdict{font-size:1.3em;border-left:.3em solid #357;padding-left:.8em}"""


def document(title: str, parts: Sequence[str]) -> str:
    """A whole page of `parts` in HTML."""
    body = "\n".join([f"<h1>{text(title)}</h1>", *parts])
    head = f"<!doctype html><meta charset=utf-8><title>{text(title)}</title>"
    return f"{head}<style>{STYLE}</style>{body}\n"


def text(value: Any) -> str:
    """`value` as HTML."""
    return html.escape(str(value))


def paragraph(value: str, kind: str = "") -> str:
    """A paragraph, of a class of the style."""
    return f"<p class={kind}>{text(value)}</p>" if kind else f"<p>{text(value)}</p>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of text cells under a `head`."""
    line = "".join(f"<th>{text(x)}</th>" for x in head)
    body = "".join("<tr>" + "".join(f"<td>{text(x)}</td>" for x in row) + "</tr>" for row in rows)
    return f"<table><tr>{line}</tr>{body}</table>"


def picture(figure, says: str) -> str:
    """A matplotlib figure as an embedded PNG that `says` so to who cannot see it; lets go of it."""
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    plt.close(figure)
    content = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{text(says)}" src="data:image/png;base64,{content}">'
