"""What every test may rely on."""

from __future__ import annotations

import signal

# A shell that starts this in the background makes it deaf to SIGINT; tests of interrupts need to hear it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
