"""HTTP connections with a timeout for the head of a request."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_TIMEOUT = 8.0  # s, for the head of a request


class TimeoutProtocol(H11Protocol):
    """Closes a connection whose next request does not begin; uvicorn has no such limit."""

    _overdue: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Start the timeout of the first request."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """Receive bytes; stop the timeout when a request's head is complete."""
        super().data_received(data)
        if self._idle and self._overdue is None:
            self._wait()
        elif not self._idle and self._overdue is not None:
            self._overdue.cancel()
            self._overdue = None

    @property
    def _idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def _wait(self) -> None:
        self._overdue = self.loop.call_later(HEAD_TIMEOUT, self._close)

    def _close(self) -> None:
        self._overdue = None
        if self._idle and not self.transport.is_closing():
            self.transport.close()
