"""The command line: which words are ours, which go to PETSc, and what each command does.

Exit statuses: 0 success; 1 the run failed (a solver, an accuracy limit, a full disk); 2 the input
is wrong (case file, command line, file named in them); 130 interrupted.
"""

import argparse
import json
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from qbxstokes import __version__
from qbxstokes.errors import CaseError, OutputError, QbxStokesError, nearest

USAGE = """\
usage: python -m qbxstokes CASE.yaml [options] [-petsc_option value ...]
       python -m qbxstokes COMMAND ...

Motion of a rigid spheroid in Stokes flow by quadrature by expansion.

commands
  check CASE ...      validate case files and stop
  new [FILE]          write a short case (--task motion); every key: --full
  info FILE           what a result (or the newest of a case) holds, how made
  plot FILE ...       pictures of results and tables (plot --help)
  animate FILE        the tumbling body as GIF or MP4 (animate --help)
  export FILE ...     results as CSV, NPZ or netCDF (export --help)
  help [TOPIC]        the manual; help keys has every key of a case
  schema              JSON Schema of case files, for editors
  doctor              versions, MPI, PETSc, threads, write access

options of a run
  --set KEY=VALUE     change a key of the case: --set body.aspect_ratio=0.2
  --explain           print what the scene needs and what it skips, then run
  --dry-run           print what would run, and stop
  -o FILE             where what is written goes, of every command that writes
  --overwrite         replace an existing result file
  --no-cache          neither read nor keep operators on disk
  --resume            go on with a run that was stopped, mend a sweep's failures
  --progress STYLE    how a sweep tells its progress: auto, bar, line, none
  --quiet             print nothing but errors
  --json              print the summary as JSON
  --version, --help

Words with one dash go to PETSc: -ts_monitor, -ksp_monitor, -log_view, ...
Exit status: 0 done, 1 the run failed, 2 the input is wrong.
"""

# Options of ours that take the word after them; every other word with two dashes stands alone.
_WITH_VALUE = ("--set", "--task", "--progress", "-o", "--output")


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Our words and PETSc's.

    A word with one dash is an option of PETSc, and so is one word after it that is not an option
    itself (a number may be negative). The case file therefore comes before PETSc's options.
    """
    own: list[str] = []
    petsc: list[str] = []
    words = iter(range(len(arguments)))
    for index in words:
        word = arguments[index]
        following = arguments[index + 1] if index + 1 < len(arguments) else None
        if word in ("-h", "--help"):
            own.append("--help")
        elif word == "-o" or word.startswith("--") or not word.startswith("-") or word == "-":
            own.append(word)
            if word in _WITH_VALUE and following is not None:
                own.append(following)
                next(words)
        else:
            petsc.append(word)
            if following is not None and not _is_option(following):
                petsc.append(following)
                next(words)
    return own, petsc


def _is_option(word: str) -> bool:
    """Whether a word starts an option: a dash before anything but a number."""
    return word.startswith("-") and not word[1:2].isdigit() and word[1:2] != "."


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are CaseErrors: one line, exit status 2."""

    def error(self, message: str) -> NoReturn:
        wrong = re.fullmatch(r"unrecognized arguments: (--\S+).*", message)
        if wrong:
            meant = nearest(wrong[1], self._option_string_actions, "")
            message = "; ".join([f"{wrong[1]}: unknown option", *([meant] if meant else [])])
        raise CaseError(f"command line: {message}; see python -m qbxstokes --help")


def _parse(own: Sequence[str]) -> argparse.Namespace:
    # Of a given width, so that argparse need not look for that of the terminal.
    width = partial(argparse.HelpFormatter, width=80)
    parser = _Parser(
        prog="qbxstokes", usage=USAGE, formatter_class=width, add_help=False, allow_abbrev=False
    )
    parser.add_argument("words", nargs="*")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--task", default="motion")
    parser.add_argument("-o", "--output", metavar="FILE")
    parser.add_argument("--progress", default="auto", choices=("auto", "bar", "line", "none"))
    flags = "explain dry-run overwrite resume no-cache quiet json version help write full"
    for flag in flags.split():
        parser.add_argument(f"--{flag}", action="store_true")
    return parser.parse_intermixed_args(list(own))


def run_command(arguments: Sequence[str]) -> int:
    """Carry out a command line; returns the exit status."""
    own, petsc = split_arguments(arguments)
    try:
        if arguments and arguments[0] in _OF_RESULTS:
            from qbxstokes.cli.pictures import picture_command

            status = picture_command(arguments[0], arguments[1:])
            sys.stdout.flush()
            return status
        options = _parse(own)
        if options.output is not None:
            options.set.append(f"output.file={json.dumps(options.output)}")
        if options.version:
            print(f"qbxstokes {__version__}", flush=True)
            return 0
        if options.help:
            print(USAGE, end="", flush=True)
            return 0
        if not options.words:
            hint = ""
            if petsc:
                hint = "; put the case file before the options with one dash, which go to PETSc"
            raise CaseError(f"command line: name a case file or a command{hint} (--help)")
        command = _COMMANDS.get(options.words[0])
        if command is not None:
            if petsc:
                raise CaseError(f"command line: {petsc[0]}: unknown option of {options.words[0]}")
            if options.output is not None and command not in (_new, _schema, _check):
                raise CaseError(f"command line: {options.words[0]} writes no file, so takes no -o")
            status = command(options, options.words[1:])
            sys.stdout.flush()
            return status
        first, commands = options.words[0], (*_COMMANDS, *_OF_RESULTS)
        if len(options.words) > 1 or not (Path(first).suffix or os.path.exists(first)):
            if Path(first).suffix in (".yaml", ".yml"):
                raise CaseError(f"command line: {options.words[1]}: one case at a time")
            right = nearest(first, commands, f"commands: {', '.join(commands)}")
            raise CaseError(
                f"command line: {first[:80]}: neither a command nor a case file; {right} "
                "(a case is run by its name alone)"
            )
    except QbxStokesError as error:
        return _fail(error)
    except OSError as error:
        return _output_lost(error)
    from qbxstokes.runs.command import run_case

    return run_case(Path(options.words[0]), options, petsc)


def _output_lost(error: OSError) -> int:
    """The exit status where standard output has failed; the error again where it names a file."""
    if error.filename is not None:
        raise error
    # Keep the interpreter from complaining at exit.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):  # whoever read it has stopped
        return 0
    told = f"qbxstokes: standard output: cannot be written ({error.strerror})"
    return _fail(OutputError(told))


def _fail(error: QbxStokesError) -> int:
    print(error, file=sys.stderr)
    return error.exit_status


def _one(words: Sequence[str], what: str) -> str:
    if len(words) != 1:
        raise CaseError(f"command line: {what}")
    return words[0]


def _check(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Validate case files; every bad one is told, the worst decides the exit status."""
    from qbxstokes.case.load import load_case
    from qbxstokes.runs.destination import target_of
    from qbxstokes.runs.plan import plan_of

    if not words:
        raise CaseError("command line: check needs at least one case file")
    status = 0
    reports: list[dict[str, Any]] = []
    for word in words:
        try:
            loaded = load_case(word, options.set)
            plan_of(loaded)
            target_of(loaded, options.overwrite)
        except QbxStokesError as error:
            reports.append({"case": word, "valid": False, "error": str(error)})
            status = max(status, _fail(error))
            continue
        reports.append({"case": word, "valid": True, "resolved": loaded.resolved()})
        for remark in loaded.remarks:
            print(f"{word}: {remark}", file=sys.stderr)
        if not (options.quiet or options.json):
            print(f"{word}: valid, task {loaded.case.task}")
    if options.json:
        print(json.dumps(reports, indent=2))
    return status


def _new(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Write a starter case to a file that does not exist yet, or to standard output."""
    from qbxstokes.case.describe import starter

    text = starter(options.task, options.full)
    if path := _put(text, options, words):
        print(f"{path}: written; run it with python -m qbxstokes {path}")
    return 0


def _put(text: str, options: argparse.Namespace, words: Sequence[str]) -> Path | None:
    """Write a text into the file that is named, to standard output without; the file to tell."""
    words = [*words, *([] if options.output is None else [options.output])]
    if not words:
        print(text, end="")
        return None
    path = Path(_one(words, f"{options.words[0]} takes one file name"))
    from qbxstokes.io.store import write_whole

    try:
        if os.path.lexists(path) and not (options.overwrite and path.is_file()):
            raise CaseError(f"{path}: exists already; choose another name or --overwrite")
        write_whole(path, text.encode())
    except OSError as error:
        raise CaseError(f"{path}: cannot be written ({error.strerror})") from None
    return None if options.quiet else path


def _info(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Describe a result file."""
    from qbxstokes.cli.pictures import told
    from qbxstokes.runs.report import describe_result, to_json

    result = told(_one(words, "info takes one result file, or a case for its newest"))
    print(to_json(result) if options.json else describe_result(result))
    return 0


def _schema(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Print the schema, or bring the file that editors use and the page of keys up to date."""
    from qbxstokes.case import describe
    from qbxstokes.cli.pages import PAGES

    if words:
        raise CaseError(f"command line: {words[0]}: schema takes no file but -o FILE")
    text = json.dumps(describe.json_schema(), indent=1) + "\n"
    if options.write:
        schema = Path(describe.__file__).with_name(describe.SCHEMA_FILE)
        page = PAGES / "keys.md"
        schema.write_text(text)
        page.write_text(describe.keys_page())
        print(f"{schema}: written\n{page}: written")
    elif path := _put(text, options, ()):
        print(f"{path}: written")
    return 0


def _doctor(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Look at the environment; exit status 1 if something is wrong."""
    from qbxstokes.cli.doctor import examine, report

    if words:
        raise CaseError(f"command line: {words[0]}: doctor takes no file")
    findings = examine()
    if options.json:
        print(json.dumps([finding.__dict__ for finding in findings], indent=2))
    else:
        print(report(findings))
    return 0 if all(finding.ok for finding in findings) else 1


def _help(options: argparse.Namespace, words: Sequence[str]) -> int:
    """Print a page of the manual, or the list of them."""
    from qbxstokes.cli.pages import contents, page

    print(page(_one(words, "help takes one topic")) if words else contents(), end="")
    return 0


_OF_RESULTS = ("plot", "animate", "export")
_COMMANDS: dict[str, Callable[[argparse.Namespace, Sequence[str]], int]] = {
    "check": _check,
    "new": _new,
    "info": _info,
    "help": _help,
    "schema": _schema,
    "doctor": _doctor,
}
