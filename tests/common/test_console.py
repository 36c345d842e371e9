"""What commands print where the output is full, closed, or knows ASCII only."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LONG = "print('a ' * 20000)"
SCRIPT = """
import os, sys
from common.command import run_command
from common.errors import InputError
def main(argv):
    {body}
run_command(main)
"""


def run(body: str, redirection: str, **environment: str) -> subprocess.CompletedProcess:
    code = SCRIPT.format(body=body)
    shell = ["sh", "-c", f'exec "$@" {redirection}', "sh"]
    return subprocess.run([*shell, sys.executable, "-c", code], cwd=ROOT, capture_output=True,
                          env=os.environ | environment)


@pytest.mark.parametrize("body", ["print('a')", LONG])
def test_a_full_output_is_one_line(body):
    found = run(body, ">/dev/full")
    assert found.returncode == 2
    assert found.stderr.startswith(b"error: No space left on device; ") and (
        found.stderr.count(b"\n") == 1)


def test_closed_outputs_are_no_error():
    for redirection in (">&-", ">&- 2>&-"):
        found = run(LONG + "; print('x', file=sys.stderr); sys.stdout.write('y')", redirection)
        assert (found.returncode, found.stdout) == (0, b"")


def test_undecodable_names_and_ascii_outputs_are_escaped():
    found = run("print(chr(181), os.fsdecode(b'\\xff')); raise InputError(chr(181) + chr(10))", "",
                PYTHONIOENCODING="ascii", PYTHONUTF8="0", LC_ALL="C")
    assert found.stdout == b"\\xb5 \\udcff\n"
    assert (found.returncode, found.stderr) == (2, b"error: \\xb5\\n\n")


# In between, from some 0.35 GB on, libraries may end the process themselves while they are loaded.
def test_a_limit_of_memory_is_one_line(tmp_path):
    """While the command is loaded; an estimate needs 1 GB."""
    room = 200_000_000
    done = subprocess.run(
        [sys.executable, "infer.py", "capture=examples/captures/twill_photograph", "drapes=0",
         f"out={tmp_path}"], cwd=ROOT, capture_output=True, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (room, room)))
    assert done.returncode == 2 and done.stderr.startswith("error: too little memory (")
    assert done.stderr.count("\n") == 1 and "ulimit -v" in done.stderr


def test_other_faults_keep_their_traceback():
    done = run("raise ImportError('no such module')", "")
    assert done.returncode == 1 and b"Traceback" in done.stderr
