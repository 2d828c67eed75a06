"""A server of step processes that is killed after it forked one and before it can say which: what Ctrl-C may meet."""

from __future__ import annotations

import os
import signal
import sys

from tasks import fork_server, worker


def die(descriptor: int, number: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    fork_server._say = die
    sys.exit(fork_server.serve(int(sys.argv[1]), worker.main))
