"""The loop of a bench's worker in another tool's environment: a JSON request a line in, a JSON answer a line out."""

import contextlib
import json
import os
import sys


def serve(make):
    """Make a worker, say that it is ready, and call its method `do` for every request.

    What the tool prints meanwhile goes nowhere: standard output carries the answers.

    Args:
        make: Called without arguments; returns the worker.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        worker = make()
        print(json.dumps({"ready": True}), file=answers, flush=True)
        for line in sys.stdin:
            request = json.loads(line)
            answer = getattr(worker, request.pop("do"))(**request)
            print(json.dumps(answer), file=answers, flush=True)
