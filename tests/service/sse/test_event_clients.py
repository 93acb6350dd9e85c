"""In which order the clients of an event stream are woken."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from dyknow.service.sse.clients import SLICE, EventClient, Rounds


@dataclass(eq=False)
class HasClients:
    clients: dict[EventClient, None] = field(default_factory=dict)


def test_who_has_listened_longest_is_woken_first() -> None:
    count = 3 * SLICE
    feed, rounds = HasClients(), Rounds()
    woken: list[str] = []

    async def listen(client: EventClient) -> None:
        await client.wait()  # who has just come looks at once
        feed.clients[client] = None
        await client.wait()
        woken.append(client.key)

    async def main() -> None:
        clients = [EventClient(str(number)) for number in range(count)]
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(listen(client)) for client in clients]
            await asyncio.sleep(0)
            tasks[0].cancel()
            del feed.clients[clients[0]]
            group.create_task(listen(EventClient("came back")))
            await asyncio.sleep(0)
            rounds.add(feed)

    asyncio.run(main())
    assert woken == [str(number) for number in range(1, count)] + ["came back"]
