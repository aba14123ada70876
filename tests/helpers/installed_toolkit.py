"""The toolkit as it is installed in another environment, and the commands of that environment."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.waiting import PATIENCE_S


@dataclass(frozen=True)
class Done:
    code: int
    stdout: str
    stderr: str


@dataclass(frozen=True)
class Toolkit:
    """An environment with the toolkit, and the folder in which its commands work."""

    environment: Path
    folder: Path

    @property
    def variables(self) -> dict[str, str]:
        """Those of a new user: nothing of this project's."""
        path = os.pathsep.join([str(self.environment / "bin"), "/usr/bin", "/bin"])
        return {"PATH": path, "HOME": str(self.folder.parent), "OMP_NUM_THREADS": "1"}

    def start(self, *words: object, **variables: str) -> subprocess.Popen[str]:
        program, *arguments = map(str, words)
        return subprocess.Popen(
            [self.environment / "bin" / program, *arguments],
            cwd=self.folder,
            env=self.variables | variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *words: object, **variables: str) -> Done:
        with self.start(*words, **variables) as process:
            stdout, stderr = process.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in stderr, stderr
        return Done(process.returncode, stdout, stderr)

    def do(self, *words: object, **variables: str) -> str:
        """The output of a command that succeeds."""
        done = self.run(*words, **variables)
        assert done.code == 0, (words, done)
        return done.stdout

    def refused(self, *words: object) -> str:
        """The one line of a command that fails before it writes anything."""
        before = sorted(self.folder.rglob("*"))
        done = self.run(*words)
        lines = done.stderr.splitlines()
        assert (done.code in (1, 2), len(lines)) == (True, 1), (words, done)
        assert sorted(self.folder.rglob("*")) == before
        return lines[0]


def names_the_extra(line: str, extra: str) -> bool:
    return re.search(rf"`pip install .*\[{extra}\].*`", line) is not None
