#include "asterism_clock.h"

#include <string.h>

#define DRIFT_PARTS 5000      /* two clocks differ by at most one part in so many, 200 ppm */
#define SLACK_NS 5000000      /* what a question may take on its way without making poses look older */
#define AHEAD_NS 100000000    /* a stamp may be ahead of what is known of the server's clock by so much */
#define RATE_1 0x3FF0000000000000U /* 1 as a double */

typedef char fits_in_two_hundred_bytes[sizeof(asterism_clock) <= 200 ? 1 : -1];

/* Fields of eight bytes, by their numbers; 0 where there are none. */
static asterism_error read_time(asterism_span rest, const uint32_t numbers[3], asterism_time *time) {
    uint64_t values[3] = {0, 0, 0}; /* session, time, rate */
    asterism_field field;
    while (rest.at != rest.end) {
        const asterism_error error = asterism_next(&rest, &field);
        if (error) return error;
        for (int k = 0; k < 3; k++) {
            if (field.type == ASTERISM_EIGHT && field.number == numbers[k]) values[k] = field.value;
        }
    }
    if (values[0] == 0) return ASTERISM_SESSION;
    if (values[1] == 0 || values[1] >= (uint64_t)ASTERISM_LATEST_NS) return ASTERISM_TIMES;
    if (values[2] != 0 && values[2] != RATE_1) return ASTERISM_RATE;
    time->session = values[0];
    time->time_ns = (int64_t)values[1];
    return ASTERISM_OK;
}

asterism_error asterism_read_beat(const uint8_t *message, size_t size, asterism_time *time) {
    static const uint32_t numbers[3] = {1, 3, 5};
    const asterism_span all = {message, size ? message + size : message};
    memset(time, 0, sizeof *time);
    return read_time(all, numbers, time);
}

asterism_error asterism_read_rig_time(const uint8_t *message, size_t size, asterism_time *time) {
    static const uint32_t numbers[3] = {15, 17, 20};
    const asterism_span all = {message, size ? message + size : message};
    memset(time, 0, sizeof *time);
    return read_time(all, numbers, time);
}

static int64_t drift_ns(const asterism_bound *bound, int64_t now_ns) {
    return now_ns > bound->at_ns ? (now_ns - bound->at_ns) / DRIFT_PARTS : 0;
}

/* Something that was stamped so arrived. */
static void heard(asterism_clock *clock, int64_t received_ns, int64_t stamp_ns) {
    asterism_bound *least = &clock->least;
    const int64_t offset_ns = stamp_ns - received_ns;
    if (least->known && offset_ns <= least->offset_ns - drift_ns(least, received_ns)) return;
    least->offset_ns = offset_ns;
    least->at_ns = received_ns;
    least->known = true;
}

/* The server's clock now, as it is known; false while it is not. */
static bool server_ns(const asterism_clock *clock, int64_t now_ns, int64_t *time_ns) {
    const asterism_bound *least = &clock->least, *most = &clock->most;
    const int64_t low = least->offset_ns - drift_ns(least, now_ns);
    const int64_t high = most->offset_ns + drift_ns(most, now_ns);
    if (!most->known) {
        *time_ns = now_ns + low;
        return clock->alone && least->known;
    }
    int64_t offset_ns = high - SLACK_NS;
    if (least->known && low > offset_ns) offset_ns = low < high ? low : high;
    *time_ns = now_ns + offset_ns;
    return true;
}

/* A stamp counts unless it lies ahead of what the server answered: false then. */
static bool arrived(asterism_clock *clock, int64_t received_ns, int64_t stamp_ns) {
    int64_t time_ns;
    clock->heard_ns = received_ns;
    if (clock->most.known && server_ns(clock, received_ns, &time_ns) && stamp_ns - time_ns > AHEAD_NS) return false;
    heard(clock, received_ns, stamp_ns);
    return true;
}

static void enter(asterism_clock *clock, uint64_t session) {
    if (clock->session == session) return;
    const bool alone = clock->alone;
    asterism_clock_start(clock, alone);
    clock->session = session;
}

void asterism_clock_start(asterism_clock *clock, bool alone) {
    memset(clock, 0, sizeof *clock);
    clock->alone = alone;
}

void asterism_clock_beat(asterism_clock *clock, const asterism_time *told, int64_t received_ns) {
    enter(clock, told->session);
    clock->told = true;
    (void)arrived(clock, received_ns, told->time_ns);
}

void asterism_clock_answer(asterism_clock *clock, const asterism_time *told, int64_t asked_ns, int64_t answered_ns) {
    asterism_bound *most = &clock->most;
    enter(clock, told->session);
    clock->told = true;
    clock->heard_ns = answered_ns;
    const int64_t offset_ns = told->time_ns - asked_ns;
    if (!most->known || offset_ns < most->offset_ns + drift_ns(most, asked_ns)) {
        most->offset_ns = offset_ns;
        most->at_ns = asked_ns;
        most->known = true;
    }
    heard(clock, answered_ns, told->time_ns);
}

asterism_error asterism_clock_pose(asterism_clock *clock, const asterism_odometry *pose, int64_t received_ns) {
    if (clock->told && pose->session != clock->session) return ASTERISM_OTHER_SESSION;
    enter(clock, pose->session);
    if (!arrived(clock, received_ns, pose->published_ns)) return ASTERISM_FUTURE;
    if (pose->exposed_ns <= clock->exposed_ns) return ASTERISM_ORDER;
    clock->exposed_ns = pose->exposed_ns;
    return ASTERISM_OK;
}

int64_t asterism_age_ns(const asterism_clock *clock, const asterism_odometry *pose, int64_t now_ns) {
    int64_t time_ns;
    if (pose->session != clock->session || !server_ns(clock, now_ns, &time_ns)) return ASTERISM_UNKNOWN;
    return time_ns - pose->exposed_ns;
}

bool asterism_is_heard(const asterism_clock *clock, int64_t now_ns) {
    return clock->heard_ns && now_ns - clock->heard_ns <= ASTERISM_SILENT_NS;
}
