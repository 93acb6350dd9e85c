"""What the data directory holds."""

from __future__ import annotations

from ....streams.time import SECOND, format_time
from ...durability.command_queue import CHECKPOINT, JOURNAL
from ...http.problems import Problem, responses
from ...http.routers import resource_router
from ...models import CheckpointModel, JournalModel, LogModel
from ...runtime.context import Context

router = resource_router("status")


@router.get("/journal", responses=responses(503))
async def read_journal(service: Context) -> JournalModel:
    """Return what the data directory holds: the log of commands, and the newest checkpoint.

    Without a data directory `recording` is false, and a restart loses everything. 503: the disk
    does not answer.
    """
    commands = service.commands
    try:
        use = await commands.disk_use()
    except (OSError, TimeoutError) as error:
        reason = str(error) or "it did not answer in time"
        raise Problem(503, "journal broken", f"the disk says nothing: {reason}") from error
    if use is None:
        return JournalModel(recording=False, log=None, checkpoint=None, free=None, failing=[])
    records, waiting = commands.uncommitted
    checkpoint = None
    if use.checkpoint is not None:
        checkpoint = CheckpointModel(
            position=use.checkpoint.position,
            bytes=use.checkpoint.size,
            written=format_time(use.checkpoint.written),
            age=max(0.0, (service.clock() - use.checkpoint.written) / SECOND),
        )
    return JournalModel(
        recording=True,
        log=LogModel(
            segments=use.log_files,
            bytes=use.log_bytes,
            first=use.log_first,
            last=commands.position,
            replayed=commands.position - (0 if checkpoint is None else checkpoint.position),
            waiting=records,
            waiting_bytes=waiting,
        ),
        checkpoint=checkpoint,
        free=use.free,
        failing=[
            service.troubles[part] for part in (JOURNAL, CHECKPOINT) if part in service.troubles
        ],
    )
