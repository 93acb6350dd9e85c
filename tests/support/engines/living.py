"""One part of an engine's life, in a process of its own, which then is killed.

    python living.py DIR SEED FIRST LAST      the commands FIRST … LAST - 1 of it, then SIGKILL
    python living.py DIR SEED FIRST end       the rest of them, then all that can be seen, as text

With ``-`` for DIR nothing is kept: FIRST is 0 then.
"""

import os
import signal
import sys
from pathlib import Path
from random import Random

from commanding import REFUSALS, life, state

from dyknow.engine.durability.commands import execute
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine

LENGTH = 60


def main(folder: str, seed: str, first: str, last: str) -> None:
    commands = life(Random(int(seed)), LENGTH)
    recorded = None if folder == "-" else RecordedEngine(Path(folder), now=0)
    engine = Engine() if recorded is None else recorded.engine
    engine.epoch = "one"
    stop = len(commands) if last == "end" else int(last)
    for command in commands[int(first) : stop]:
        try:
            if recorded is None:
                execute(engine, command)
            else:
                recorded.do(command)
        except REFUSALS:
            continue
    if recorded is not None:
        recorded.log.commit()
        # Some go on from a checkpoint, some from the commands alone.
        if Random(f"{seed} {first}").random() < 0.5:
            recorded.checkpoint().write()
    if last == "end":
        for part, value in state(engine).items():
            print(part, value)
        sys.stdout.flush()
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    main(*sys.argv[1:])
