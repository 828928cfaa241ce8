/* Preloaded: the wall clock stands JUMP seconds off after AFTER seconds, and back again after as long; no other clock. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static int (*real_clock)(clockid_t, struct timespec *);

static time_t off(void) {
    static struct timespec begun;
    struct timespec now;
    const char *jump = getenv("JUMP"), *after = getenv("AFTER");
    if (!real_clock) real_clock = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    real_clock(CLOCK_MONOTONIC, &now);
    if (!begun.tv_sec) begun = now;
    if (!jump || !after) return 0;
    return ((now.tv_sec - begun.tv_sec) / atol(after)) % 2 ? atol(jump) : 0;
}

int clock_gettime(clockid_t id, struct timespec *t) {
    time_t seconds = off();
    int done = real_clock(id, t);
    if (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) t->tv_sec += seconds;
    return done;
}

int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}
