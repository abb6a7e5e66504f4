"""What would happen: the motion on a guardrail and links that bend."""

from __future__ import annotations

__all__: list[str] = []
