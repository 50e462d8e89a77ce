"""A command line run in this process, as a subprocess would be."""

import contextlib
import io
import os
import subprocess


def in_process(folder, command, arguments):
    """Call a command with its arguments in a folder; what it printed and its status."""
    out, err, before = io.StringIO(), io.StringIO(), os.getcwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = command(list(arguments))
    except SystemExit as end:
        status = end.code
    finally:
        os.chdir(before)
    return subprocess.CompletedProcess(arguments, int(status), out.getvalue(), err.getvalue())
