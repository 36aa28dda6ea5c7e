"""How old a pose is, by the server's own clock as far as this machine can know it. Pure: no clock, no network.

Clocks of two machines have nothing in common but their pace, and that within `DRIFT`. What is known of the server's
clock are bounds: it had reached a stamp when the stamp arrived, and it had not passed the time that it told in an
answer when the question went out. Data that waited in a queue loosen the first bound, a slow question the second; none
makes a pose look fresher than it is by more than `SLACK_S`.
"""

from typing import NamedTuple

DRIFT = 200e-6  # of two clocks against each other, at most
SLACK_S = 0.005  # what a question may take on its way without making poses look older
FASTEST = 1e6  # replay


class _Bound(NamedTuple):
    offset_ns: int  # server's clock less the rate times this machine's
    at_ns: int  # this machine's clock


class SessionAge:
    """The server's clock in one session. Times of this machine are ns of a monotonic clock.

    ``rate`` is that at which the server's clock runs: 1, or a replay's speed. Safe to feed from several threads: each
    bound is one value.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self.rate = rate
        self.told = False  # the server was asked for its clock, and answered
        self.alone = False  # it tells none: ages rest on the least delay alone
        self.waited = False  # somebody has waited for it already
        self._least: _Bound | None = None
        self._most: _Bound | None = None

    @property
    def known(self) -> bool:
        """Whether ages can be told."""
        return self.told or self.alone

    def runs_at(self, rate: float) -> None:
        """The server says how fast its clock runs; what was learned at another rate is forgotten."""
        if 0.0 < rate <= FASTEST and rate != self.rate:
            self.rate, self._least, self._most = rate, None, None

    def heard(self, received_ns: int, stamp_ns: int) -> None:
        """Something that was stamped at ``stamp_ns`` arrived."""
        offset_ns = stamp_ns - round(self.rate * received_ns)
        before = self._least
        if before is None or offset_ns > before.offset_ns - self._drift_ns(received_ns - before.at_ns):
            self._least = _Bound(offset_ns, received_ns)

    def answered(self, asked_ns: int, answered_ns: int, time_ns: int) -> None:
        """The server was asked for its clock, and the answer is here."""
        offset_ns = time_ns - round(self.rate * asked_ns)
        before = self._most
        if before is None or offset_ns < before.offset_ns + self._drift_ns(asked_ns - before.at_ns):
            self._most = _Bound(offset_ns, asked_ns)
        self.heard(answered_ns, time_ns)
        self.told = True

    def time_ns(self, now_ns: int) -> int | None:
        """The server's clock now, or None while nothing is known of it."""
        least, most = self._least, self._most
        if most is None:
            if not self.alone or least is None:
                return None
            return round(self.rate * now_ns) + least.offset_ns - self._drift_ns(now_ns - least.at_ns)
        high = most.offset_ns + self._drift_ns(now_ns - most.at_ns)
        offset_ns = high - round(self.rate * SLACK_S * 1e9)
        if least is not None:
            offset_ns = max(offset_ns, least.offset_ns - self._drift_ns(now_ns - least.at_ns))
        return round(self.rate * now_ns) + min(offset_ns, high)

    def age_s(self, now_ns: int, exposed_ns: int) -> float:
        """Seconds of the server's clock since ``exposed_ns``; infinite while nothing is known of that clock."""
        time_ns = self.time_ns(now_ns)
        return float("inf") if time_ns is None else (time_ns - exposed_ns) * 1e-9

    def _drift_ns(self, passed_ns: int) -> int:
        return round(DRIFT * self.rate * max(passed_ns, 0))
