"""`spacearm`: parse, dispatch, and turn errors into one line and an exit code.

Exit codes: 0 done; 1 ran, and found the data unfit; 2 usage, or input that cannot be read; 3 ran, and the model that
`identify` wrote is poor or suspect.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import warnings
from collections.abc import Collection, Sequence
from importlib import import_module

from .. import __version__
from ..blas_threads import one_thread
from ..errors import UnfitDataError, UserError

COMMANDS = {
    "demo": "the whole chain on the simulated arm",
    "new-arm": "write the configuration files of your arm",
    "check": "check recordings, or machine and files",
    "import": "find out what the columns of a log are, and write a mapping or a bag",
    "excite": "optimise an excitation trajectory",
    "identify": "identify an arm from recordings",
    "batch": "identify many bags, and show trends",
    "simulate": "record the simulated arm",
    "report": "(re)write the HTML report of a result folder, or of several",
    "export": "write a model for simulators and controllers",
    "payload": "identify what the arm holds",
    "mismatch": "locate and explain a mismatch",
    "calibrate-temperature": "fit alpha, friction over temperature",
    "watch": "show the live graph on this terminal",
    "node": "start a ROS 2 node",
}
"""Each command and what it does. Its module has its options, and imports what it plots and solves with: seconds."""

SMALL_MATRICES = ("check",)
"""Commands whose matrices are so small that threads of BLAS cost more than they save."""


def parser(names: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The command line: the commands of `names` with their options, the others as a line of the overview."""
    top = argparse.ArgumentParser(
        prog="spacearm",
        description="Identify the dynamics of a robot arm from its recordings.",
        epilog="spacearm COMMAND --help: its options. Exit codes: 0 done, 1 data unfit, 2 usage or unreadable input, "
        "3 the identified model is poor or suspect.",
    )
    top.add_argument("--version", action="version", version=f"spacearm_ident {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, what in COMMANDS.items():
        command = commands.add_parser(name, help=what)
        if name in names:
            import_module(f".{name.replace('-', '_')}", __package__).add(command)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    one_thread()  # The commands import numpy: not before this line.
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None and not sys.warnoptions:
        # Warnings of libraries are for who develops this package (python -W, PYTHONWARNINGS): users can do nothing.
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"  # in processes started from here as well
    if words[:1] and words[0] in SMALL_MATRICES:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read once, when numpy is first imported
            os.environ.setdefault(name, "1")
    options = parser([word for word in words if word in COMMANDS][:1]).parse_args(words)
    options.command_line = shlex.join(["spacearm", *words])
    try:
        return int(options.run(options))
    except UnfitDataError as error:
        print(f"spacearm: {error}", file=sys.stderr)
        return 1
    except UserError as error:
        print(f"spacearm: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("spacearm: interrupted; what it was to write is missing or incomplete", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`spacearm ... | head`): not an error of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
