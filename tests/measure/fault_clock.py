"""Programs whose wall clock can be stepped: a library of ours stands before the C library's `clock_gettime`."""

import os
import struct
import subprocess
from pathlib import Path

SOURCE = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long long *step;

__attribute__((constructor)) static void begin(void) {
    int file = open(getenv("STEPPED_CLOCK"), O_RDONLY);
    step = mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
}

int clock_gettime(clockid_t id, struct timespec *told) {
    int result = syscall(SYS_clock_gettime, id, told);
    if (id == CLOCK_REALTIME && step) {
        long long ns = told->tv_sec * 1000000000LL + told->tv_nsec + *step;
        told->tv_sec = ns / 1000000000LL;
        told->tv_nsec = ns % 1000000000LL;
    }
    return result;
}

int gettimeofday(struct timeval *told, void *zone) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    told->tv_sec = now.tv_sec;
    told->tv_usec = now.tv_nsec / 1000;
    return 0;
}
"""


class SteppedClock:
    """Of whatever is started with ``environment``. Needs a C compiler by the name of cc."""

    def __init__(self, folder: Path) -> None:
        self._step = folder / "step"
        self.set(0)
        (folder / "clock.c").write_text(SOURCE)
        library = folder / "clock.so"
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, folder / "clock.c"], check=True)
        self.environment = {**os.environ, "LD_PRELOAD": str(library), "STEPPED_CLOCK": str(self._step)}

    def set(self, step_s: float) -> None:
        """Seconds that it is ahead of this machine's, from now on."""
        with self._step.open("r+b" if self._step.exists() else "wb") as file:
            file.write(struct.pack("q", round(step_s * 1e9)))
