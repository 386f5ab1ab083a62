"""Ctrl-C in a process of its own: one line and status 130, whatever runs.

An exception raised while an extension module is imported can be lost, or crash the process; one
raised in a callback of the garbage collector is lost. So the process ends at once until all is
imported, and a lost interrupt is sent again.
"""

import os
import signal
import sys

STATUS = 130


def end_at_once(name: str) -> None:
    """Lets an interrupt print one line and end the process.

    A signal that the caller ignores or handles stays as it is.
    """

    def end(number, frame) -> None:
        os.write(2, f"{name}: interrupted.\n".encode())
        os._exit(STATUS)

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler or _is_ours():
        end.is_ours = True  # type: ignore[attr-defined]
        signal.signal(signal.SIGINT, end)


def raise_again() -> None:
    """Lets an interrupt raise `KeyboardInterrupt` again, so that files are tidied up."""
    if _is_ours():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = _send_again


def _is_ours() -> bool:
    return getattr(signal.getsignal(signal.SIGINT), "is_ours", False)


def _send_again(lost) -> None:
    """Sends an interrupt again that was raised where no code could catch it."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    import _thread
    import threading

    threading.Timer(0.01, _thread.interrupt_main).start()
