"""Messages of errors: one line, short enough, with what matters most."""

import pickle
import re
from itertools import accumulate

import pytest
from hypothesis import given, strategies as st

from cmbot.common.errors import (
    LONGEST_MESSAGE,
    CmbotError,
    InputError,
    MissingExtra,
    OptimisationFailed,
    PathNotFound,
    SceneError,
    one_line,
    whole_sentences,
)
from cmbot.common.reading.validation import shown

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


def test_an_error_is_the_same_in_another_process() -> None:
    errors = (
        CmbotError("text", "end"),
        SceneError("scene.yaml", "speed", 0, "more", ["1", "2"], line=7),
        PathNotFound("late", time=1.0, progress=0.5, smallest_singular_value=1e-4, pair=("a", "b")),
        MissingExtra("dask", "campaign"),
    )
    for error in errors:
        error.add_source("job.yaml")
        error.add_hint("a hint")
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error)
        assert str(again) == str(error)
        assert vars(again) == vars(error)
        again.add_hint("another")
        assert str(again) == f"{error}; another"


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


def sentences(most: int = 25) -> st.SearchStrategy[str]:
    """Sentences of words; some have brackets or values with semicolons in them, or a long value."""
    asides = st.sampled_from(["", " (too near; by 4 mm)", " 'a; b'", " (Chang 2021, Eq. (12); 3 of 4)"])
    words = st.lists(st.sampled_from(["arm", "joint's", "limit", "3.5", "Nm"]), min_size=2, max_size=most)
    return st.tuples(words, asides).map(lambda parts: "".join((" ".join(parts[0]), parts[1])))


TEXTS = st.lists(st.tuples(sentences(), st.sampled_from(["; ", ". It "])), min_size=1, max_size=30).map(
    lambda each: [sentence + join for sentence, join in each]
)


def wholes(parts: list[str]) -> set[str]:
    """What a text may be shortened to: it, up to the end of one of its sentences."""
    return {re.sub("(; |. It )$", "", text) + "." * text.endswith(". It ") for text in accumulate(parts)}


@given(TEXTS, st.integers(150, 400))
def test_text_is_shortened_by_whole_sentences(parts: list[str], length: int) -> None:
    text = "".join(parts).removesuffix("; ").removesuffix(" It ")
    short = whole_sentences(text, length)
    assert len(short) <= length
    fitting = [whole for whole in wholes(parts) if len(whole) <= length]
    if not fitting:  # the first sentence alone is too long
        assert "…" in short
        return
    assert short == max(fitting, key=len)


def pieces(text: str) -> list[str]:
    """A text's sentences, and the parts of one that semicolons end."""
    return re.split(r"; |(?<=\.) (?=It )", text)


@given(TEXTS, st.lists(sentences(15), max_size=3))
def test_messages_are_whole_sentences_hints_included(parts: list[str], hints: list[str]) -> None:
    text = "".join(parts).removesuffix("; ").removesuffix(" It ")
    worst = "worst constraint: jerk of joint_1 at t = 1.50 s, 10.00% beyond its bound"
    near = "near a singular posture (smallest singular value 0.01)"
    kinds = (
        (OptimisationFailed(text, constraint="jerk of joint_1", violation=0.1, time=1.5), "", worst),
        (
            PathNotFound(text, time=1.0, progress=0.5, smallest_singular_value=0.01),
            "no path beyond t = 1.00 s (50% of the tool path): ",
            near,
        ),
        (InputError("scene.yaml", "key", "'x'", text), "scene.yaml: key: got 'x', expected ", ""),
        (CmbotError(text), "", ""),
    )
    for error, begin, end in kinds:
        for hint in hints:
            error.add_hint(hint)
        error.add_source("triangle")
        said = str(error)
        assert len(said) <= LONGEST_MESSAGE
        assert said.startswith(f"triangle: {begin}")
        if end:
            assert end in said
        if hints and len(hints[0]) < 100:
            assert f"; {hints[0]}" in said
        if "…" not in said:
            known = {*pieces(text), *pieces("; ".join(hints)), *pieces(end)}
            assert {*pieces(said.removeprefix(f"triangle: {begin}"))} <= known


@given(st.text(max_size=600), TEXTS)
def test_of_a_wrong_value_the_key_and_what_to_do_are_said(value: str, parts: list[str]) -> None:
    expected = parts[0].removesuffix("; ").removesuffix(" It ")
    error = InputError(f"{'folder/' * 60}scene.yaml", "tool_path.legs[1].seconds", value, expected, line=7)
    assert len(str(error)) <= LONGEST_MESSAGE
    assert "scene.yaml:7: tool_path.legs[1].seconds: " in str(error)
    if len(expected) < 150:
        assert str(error).endswith(f", expected {expected}")


@given(st.text(min_size=1, max_size=300))
def test_a_value_that_is_shown_short_keeps_its_quotes(text: str) -> None:
    value = shown(text)
    assert len(value) <= 60
    assert value[0] == value[-1] == repr(text)[0]


def test_a_missing_package_is_said_with_its_hint() -> None:
    error = MissingExtra("xacrodoc", "xacro", "pip install 'cmbot-planner[xacro]'")
    error.add_hint("arm.xacro is xacro, not yet a URDF")
    said = "xacrodoc is not installed; run: pip install 'cmbot-planner[xacro]'"
    assert str(error) == error.args[0] == f"{said}; arm.xacro is xacro, not yet a URDF"
