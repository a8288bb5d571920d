"""A TCP relay between machine and router that can misbehave: cut, black hole, hold and heal, delay."""

import asyncio
import contextlib
import threading
import time


class Relay:
    """Forwards one port to another; its faults are set from the test's thread."""

    def __init__(self, target_port: int) -> None:
        self._target_port = target_port
        self._loop = asyncio.new_event_loop()
        self._is_held = {"up": False, "down": False}
        self._delay_s = 0.0
        self._writers: set[asyncio.StreamWriter] = set()
        self._is_refusing = False
        self.held_bytes = 0
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        started = asyncio.run_coroutine_threadsafe(
            asyncio.start_server(self._accept, "127.0.0.1", 0), self._loop
        )
        self._server = started.result(5.0)
        self.port = self._server.sockets[0].getsockname()[1]

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.port}"

    def hold(self, direction: str = "both") -> None:
        """Keep what comes in: `up` is machine -> server, `down` server -> machine. TCP sees nothing."""
        for name in self._is_held:
            if direction in (name, "both"):
                self._is_held[name] = True

    def heal(self) -> None:
        """Deliver what was held, in order, and go on."""
        self._is_held = dict.fromkeys(self._is_held, False)

    def delay(self, seconds: float) -> None:
        """Each piece of data takes so long, both ways."""
        self._delay_s = seconds

    def cut(self) -> None:
        """Drop all connections and refuse new ones."""
        self._is_refusing = True
        self._loop.call_soon_threadsafe(self._abort_all)

    def mend(self) -> None:
        """Accept connections again."""
        self._is_refusing = False

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._shut(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()

    async def _shut(self) -> None:
        self._server.close()
        self._abort_all()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _abort_all(self) -> None:
        for writer in list(self._writers):
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._is_refusing:
            writer.transport.abort()
            return
        try:
            up_reader, up_writer = await asyncio.open_connection("127.0.0.1", self._target_port)
        except OSError:
            writer.transport.abort()
            return
        self._writers |= {writer, up_writer}
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(
                self._pipe(reader, up_writer, "up"), self._pipe(up_reader, writer, "down")
            )
        self._writers -= {writer, up_writer}

    async def _pipe(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, direction: str
    ) -> None:
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        sender = asyncio.create_task(self._send(waiting, writer, direction))
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                waiting.put_nowait((time.monotonic() + self._delay_s, data))
        # Even the end of the connection is held back: a black hole says nothing.
        waiting.put_nowait((0.0, b""))
        with contextlib.suppress(OSError):
            await sender

    async def _send(
        self,
        waiting: asyncio.Queue[tuple[float, bytes]],
        writer: asyncio.StreamWriter,
        direction: str,
    ) -> None:
        while True:
            due_s, data = await waiting.get()
            while self._is_held[direction]:
                await asyncio.sleep(0.01)
            if (left_s := due_s - time.monotonic()) > 0.0:
                await asyncio.sleep(left_s)
            if not data:
                writer.close()
                return
            writer.write(data)
            await writer.drain()
