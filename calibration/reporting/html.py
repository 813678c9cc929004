"""Makes a report page from a template: one HTML file that contains its tables and pictures."""

import base64
import io
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

TEMPLATES = Environment(
    loader=PackageLoader("calibration.reporting"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def render_page(template: str, **content: Any) -> str:
    """Returns the HTML page of a template in `templates/`; texts in `content` are HTML-escaped."""
    return TEMPLATES.get_template(template).render(content)


def embedded_png(figure) -> str:
    """Returns a matplotlib figure as a base64 PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return base64.b64encode(buffer.getvalue()).decode()
