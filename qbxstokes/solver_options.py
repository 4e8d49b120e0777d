"""Which options of PETSc a run takes: what they must leave alone, and what a case may not ask for.

Where a motion ends, where its samples are and how exact they are is said in the case, and found by
the program's own loop over the steps: an option that moves one of these, or that takes a method
without an estimate of its error, would give wrong samples that nothing tells. Such options are
refused wherever they come from. A case, which somebody else may have written, names no Python code
and no files; the command line, which the user types, may.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

# Methods with an error estimate, with those of their formulas that have one.
METHODS: dict[str, tuple[str, ...]] = {
    "rk": ("3bs", "5f", "5dp", "5bs", "6vr", "7vr", "8vr"),
    "bdf": (),
    "arkimex": ("2c", "2d", "2e", "3", "4", "5"),
    "rosw": ("ra3pw", "ra34pw2", "rodas3", "sandu3"),
}
_TOLERANCE = "time.tolerance is the error control"
_SAMPLES = "time.end, time.periods or time.at say when a motion ends, time.samples what is stored"
_ITSELF = "the program sets it itself"
# Options of the integrator that are refused, and what would be right.
_REFUSED = {
    name: right
    for right, names in {
        _TOLERANCE: "rtol atol adapt_dt_min adapt_always_accept adapt_max_ignore adapt_ignore_max",
        _SAMPLES: "max_time final_time init_time initial_time exact_final_time time_span "
        "eval_times run_steps",
        _ITSELF: "dt time_step rk_multirate use_splitrhsfunction error_if_step_fails "
        "max_snes_failures snes_convergence_test snes_no_convergence_test snes_mf "
        "snes_mf_operator snes_fd",
    }.items()
    for name in (f"ts_{word}" for word in names.split())
}
_CHOICES = {
    "ts_type": tuple(METHODS),
    "ts_rk_type": METHODS["rk"],
    "ts_arkimex_type": METHODS["arkimex"],
    "ts_rosw_type": METHODS["rosw"],
    "ts_adapt_type": ("basic", "dsp"),
    "ts_snes_type": ("newtonls", "newtontr"),
}
# What a case may say: options of the integrator and of the linear solvers, with plain values.
_OF_CASE = ("ts_", "ksp_", "pc_", "sub_ksp_", "sub_pc_", "log_view", "info")
_PLAIN = re.compile(r"[A-Za-z0-9_.,+-]*\Z")
_ACTING = re.compile(r"python|trajectory|draw|vtk|_lg_|_hg_|_sp_|saws|binary|mat_?file|history")
_SHOWING = re.compile(r"monitor|view|converged_reason|converged_rate|test_jacobian|info")
_ON, _OFF = (
    ("", "true", "on", "yes", "1", "ascii", "::ascii_info_detail"),
    ("false", "off", "no", "0"),
)


def text_of(value: Any) -> str:
    """The value of an option as PETSc reads it."""
    if value is None or value is True:
        return ""
    return "false" if value is False else str(value)


def misleading(options: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Options that would make a run wrong without a word: name, what is wrong, what is right."""
    for name, value in options.items():
        given = text_of(value).lower()
        if value is None and name in _CHOICES:
            continue  # in a sweep of options: not given, the program chooses
        if name in _REFUSED:
            yield name, "would move the end, the samples or the error of a motion", _REFUSED[name]
        elif name in _CHOICES and given not in _CHOICES[name]:
            wrong = f"{given or 'nothing'!r} has no error estimate that the program controls"
            yield name, wrong, f"one of {', '.join(_CHOICES[name])}"


def foreign_to_a_case(options: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Options that a case may not give: name, what is wrong, what would be right."""
    for name, value in options.items():
        given = text_of(value)
        typed = f"give it on the command line: -{name} {given}".rstrip()
        if not name.startswith(_OF_CASE):
            yield name, "is no option of the solvers", typed
        elif _ACTING.search(name) or "python" in given.lower() or not _PLAIN.match(given):
            yield name, "runs code, opens windows or writes files", typed
        elif _SHOWING.search(name) and given.lower() not in (*_ON, *_OFF):
            yield name, f"{given!r} is neither on nor off", f"{name}: on, or {typed}"


def given(options: Mapping[str, Any]) -> dict[str, str | None]:
    """The options of a case as PETSc is given them: monitors are on, or are not there at all."""
    found: dict[str, str | None] = {}
    for name, value in options.items():
        text = text_of(value)
        if _SHOWING.search(name):
            if text.lower() not in _OFF:
                found[name] = None
        elif text or name not in _CHOICES:
            found[name] = text or None
    return found
