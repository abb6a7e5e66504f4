"""Messages of errors: one line, short enough, with what matters most."""

import pytest

from cmbot.common.errors import LONGEST_MESSAGE, CmbotError, InputError, PathNotFound, one_line

CHOICES = [f"link_number_{k}" for k in range(60)]


@pytest.mark.parametrize("text", ["a\nb", "a\x1b[31m", "a\u2028b\x85c", "\ud800", "x" * 10_000])
def test_a_message_is_one_short_printable_line(text: str) -> None:
    stopped = PathNotFound(text, time=1.0, progress=0.5, smallest_singular_value=0.1)
    for error in (CmbotError(text), InputError(text, text, text, text, [text] * 3, line=7), stopped):
        error.add_hint("a hint")
        assert str(error).isprintable()
        assert len(str(error)) <= LONGEST_MESSAGE
        assert str(error).endswith("; a hint")
        error.add_source(f"{text}.yaml")
        assert ".yaml: " in str(error)
        assert str(error).isprintable()
        assert len(str(error)) <= LONGEST_MESSAGE
        assert str(error).endswith("; a hint")


def test_one_line_keeps_blanks_and_letters() -> None:
    assert one_line("two  blanks, ünïcode 狗") == "two  blanks, ünïcode 狗"


def test_a_line_is_said_behind_the_file() -> None:
    error = InputError("scene.yaml", "tool_path.keep", "'axes'", "a known value", ["pose"])
    assert str(error) == "scene.yaml: tool_path.keep: got 'axes', expected a known value (one of: pose)"
    error.set_line(12)
    assert str(error) == "scene.yaml:12: tool_path.keep: got 'axes', expected a known value (one of: pose)"


def test_as_many_choices_are_listed_as_there_is_room_for() -> None:
    text = str(InputError("arm.urdf", "tool_frame", "'x'", "a link of the URDF", CHOICES))
    assert text.startswith(
        "arm.urdf: tool_frame: got 'x', expected a link of the URDF (one of: link_number_0, "
    )
    listed, _, others = text.partition(" and ")
    assert others == f"{60 - listed.count('link_number_')} more)"
    assert LONGEST_MESSAGE - 30 < len(text) <= LONGEST_MESSAGE


def test_of_a_long_value_beginning_and_end_are_kept() -> None:
    text = str(InputError("f" * 300, "key", f"begin {'x' * 5000} end", "something"))
    assert text.endswith(" end, expected something")
    assert "key: got begin xx" in text
    assert len(text) <= LONGEST_MESSAGE


def test_a_path_that_ends_near_a_singular_posture_says_so() -> None:
    near, far = (
        str(PathNotFound("stuck", time=1.0, progress=0.5, smallest_singular_value=value))
        for value in (0.0025, 0.24)
    )
    assert near == f"{far}; near a singular posture (smallest singular value 0.0025)"
