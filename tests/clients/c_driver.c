/* The C client at the mercy of a test: messages or events on stdin, what was made of them on stdout. Numbers are of
 * this machine's order of bytes. See c_client.py.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "asterism_clock.h"

static void put(const void *what, size_t size) {
    if (fwrite(what, size, 1, stdout) != 1) exit(3);
}

static bool get(void *what, size_t size) { return fread(what, size, 1, stdin) == 1; }

static void put_reals(const asterism_real *reals, size_t count) {
    for (size_t k = 0; k < count; k++) {
        const double real = (double)reals[k];
        put(&real, sizeof real);
    }
}

static void put_pose(const asterism_odometry *pose) {
    const uint8_t flags[5] = {pose->state, pose->leds, pose->smoothed, pose->extrapolated, pose->has_velocity};
    put(&pose->exposed_ns, 8);
    put(&pose->published_ns, 8);
    put(&pose->session, 8);
    put(&pose->sequence, 8);
    put_reals(pose->position, 3);
    put_reals(pose->orientation, 4);
    put_reals(pose->covariance, 36);
    put_reals(&pose->rms_px, 1);
    put_reals(pose->linear, 3);
    put_reals(pose->angular, 3);
    put_reals(pose->velocity_covariance, 36);
    put_reals(&pose->acceleration, 1);
    put_reals(&pose->turn_acceleration, 1);
    put(flags, sizeof flags);
    put(pose->frame_id, sizeof pose->frame_id);
    put(pose->robot, sizeof pose->robot);
}

/* The next message in memory of just its size, so that a byte read past it is an error. */
static uint8_t *next_message(uint32_t *size) {
    if (!get(size, sizeof *size)) return NULL;
    uint8_t *message = malloc(*size ? *size : 1);
    if (message == NULL || (*size && !get(message, *size))) exit(3);
    return message;
}

static void poses(const char *robot) {
    static const asterism_odometry nothing;
    asterism_odometry pose;
    uint32_t size;
    for (uint8_t *message; (message = next_message(&size)) != NULL; free(message)) {
        const uint8_t error = (uint8_t)asterism_read_odometry(message, size, robot, &pose);
        put(&error, 1);
        if (error && memcmp(&pose, &nothing, sizeof pose) != 0) exit(4);
        if (!error) put_pose(&pose);
    }
}

static void times(bool of_rig) {
    asterism_time time;
    uint32_t size;
    for (uint8_t *message; (message = next_message(&size)) != NULL; free(message)) {
        const uint8_t error = (uint8_t)(of_rig ? asterism_read_rig_time : asterism_read_beat)(message, size, &time);
        put(&error, 1);
        put(&time.session, 8);
        put(&time.time_ns, 8);
    }
}

/* What happens to a clock, and after each the age of a pose and what a pose was taken for. */
static void events(bool alone) {
    struct { int64_t what, session, first_ns, second_ns, third_ns; } event;
    asterism_clock clock;
    asterism_odometry pose;
    memset(&pose, 0, sizeof pose);
    asterism_clock_start(&clock, alone);
    while (get(&event, sizeof event)) {
        const asterism_time time = {(uint64_t)event.session, event.first_ns};
        int64_t told[3] = {0, 0, 0};
        pose.session = (uint64_t)event.session;
        pose.published_ns = event.first_ns;
        pose.exposed_ns = event.third_ns;
        switch (event.what) {
            case 'b': asterism_clock_beat(&clock, &time, event.second_ns); break;
            case 'a': asterism_clock_answer(&clock, &time, event.second_ns, event.third_ns); break;
            case 'p': told[0] = (int64_t)asterism_clock_pose(&clock, &pose, event.second_ns); break;
            default: told[1] = asterism_age_ns(&clock, &pose, event.second_ns);
        }
        told[2] = asterism_is_heard(&clock, event.second_ns);
        put(told, sizeof told);
    }
}

int main(int count, char **words) {
    if (count < 2) return 2;
    if (!strcmp(words[1], "poses")) poses(count > 2 ? words[2] : NULL);
    if (!strcmp(words[1], "beats")) times(false);
    if (!strcmp(words[1], "rigs")) times(true);
    if (!strcmp(words[1], "events")) events(false);
    if (!strcmp(words[1], "alone")) events(true);
    if (!strcmp(words[1], "words")) {
        for (int k = 0; k <= ASTERISM_ERRORS; k++) puts(asterism_words((asterism_error)k));
    }
    return fflush(stdout) ? 3 : 0;
}
