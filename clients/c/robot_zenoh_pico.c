/* A robot that drives by Asterism's poses and stops without them, with zenoh-pico 1.10 (Zephyr, FreeRTOS, ESP-IDF,
 * Arduino-ESP32, Linux, ...).
 *
 * README.md beside this file says how to build it, and what a board needs. `drive` and `stop` are yours. On a board call
 * `robot_run` from its task, once its network is up. Where several cameras see the robot, name one, or keep a clock for
 * each. SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <zenoh-pico.h>

#include "asterism_clock.h"

#ifndef ROBOT
#define ROBOT "alpha"
#endif
#ifndef CAMERA
#define CAMERA "*"
#endif
#ifndef ENDPOINT
#define ENDPOINT "tcp/127.0.0.1:7447"
#endif

#define MOST_AGE_NS 100000000 /* older poses are not driven by */
#define LOOP_MS 10
#define ASK_EVERY_NS 10000000000 /* for the server's clock */

static struct {
    asterism_clock clock;
    asterism_odometry pose; /* the newest */
    bool has_pose;
    bool asking; /* a question is under way */
    int64_t asked_ns;
    asterism_error refused; /* why the newest message was, for people */
} robot;

#if Z_FEATURE_MULTI_THREAD == 1 /* zenoh-pico reads from the network on a thread of its own, and calls from there */
static z_owned_mutex_t mutex;
static void begin(void) { z_mutex_init(&mutex); }
static void lock(void) { z_mutex_lock(z_mutex_loan_mut(&mutex)); }
static void unlock(void) { z_mutex_unlock(z_mutex_loan_mut(&mutex)); }
#else
static void begin(void) {}
static void lock(void) {}
static void unlock(void) {}
#endif

/* ns since the start, by a clock that nobody sets. A board's own wraps around after 71 minutes: it is read often, and
 * what passed is summed. Call it under the lock. */
static int64_t now_ns(void) {
    static z_clock_t last;
    static int64_t passed_ns = 0;
    if (passed_ns == 0) {
        last = z_clock_now();
        passed_ns = 1;
    }
    const unsigned long passed_us = z_clock_elapsed_us(&last);
    z_clock_advance_us(&last, passed_us);
    return passed_ns += (int64_t)passed_us * 1000;
}

static void drive(const asterism_odometry *pose, int64_t age_ns) {
    static unsigned count;
    if (count++ % 20) return;
    printf("%s at %.4f %.4f %.4f m in %s, %.1f ms old, %d LEDs%s\n", pose->robot, (double)pose->position[0],
           (double)pose->position[1], (double)pose->position[2], pose->frame_id, (double)age_ns * 1e-6, pose->leds,
           pose->state == ASTERISM_TILT_AMBIGUOUS ? ", tilt ambiguous" : "");
}

static void stop(const char *why) { printf("stop: %s\n", why); }

/* The bytes of a sample, if they fit: how many. */
static size_t payload(const z_loaned_sample_t *sample, uint8_t *bytes, size_t room) {
    const z_loaned_bytes_t *all = z_sample_payload(sample);
    z_bytes_reader_t reader = z_bytes_get_reader(all);
    return z_bytes_len(all) <= room ? z_bytes_reader_read(&reader, bytes, room) : 0;
}

static void on_pose(z_loaned_sample_t *sample, void *unused) {
    static uint8_t bytes[ASTERISM_LONGEST_MESSAGE]; /* not on the stack of a small board; one call at a time */
    static asterism_odometry pose;
    (void)unused;
    lock();
    const int64_t received_ns = now_ns();
    asterism_error error = asterism_read_odometry(bytes, payload(sample, bytes, sizeof bytes), ROBOT, &pose);
    if (!error) error = asterism_clock_pose(&robot.clock, &pose, received_ns);
    if (!error) {
        robot.pose = pose;
        robot.has_pose = true;
    }
    robot.refused = error;
    unlock();
}

static void on_beat(z_loaned_sample_t *sample, void *unused) {
    uint8_t bytes[256];
    asterism_time told;
    (void)unused;
    lock();
    const int64_t received_ns = now_ns();
    if (!asterism_read_beat(bytes, payload(sample, bytes, sizeof bytes), &told))
        asterism_clock_beat(&robot.clock, &told, received_ns);
    unlock();
}

#if Z_FEATURE_QUERY == 1
/* The server's answer for its rig, of which the clock is wanted. One that is longer than Z_FRAG_MAX_SIZE does not come:
 * ages rest on the least delay then. */
static void on_answer(z_loaned_reply_t *reply, void *unused) {
    z_owned_slice_t rig;
    asterism_time told;
    (void)unused;
    if (!z_reply_is_ok(reply) || z_bytes_to_slice(z_sample_payload(z_reply_ok(reply)), &rig) != Z_OK) return;
    const z_loaned_slice_t *bytes = z_slice_loan(&rig);
    lock();
    const int64_t answered_ns = now_ns();
    if (!asterism_read_rig_time(z_slice_data(bytes), z_slice_len(bytes), &told))
        asterism_clock_answer(&robot.clock, &told, robot.asked_ns, answered_ns);
    unlock();
    z_slice_drop(z_slice_move(&rig));
}

static void on_last_answer(void *unused) {
    (void)unused;
    lock();
    robot.asking = false;
    unlock();
}

static void ask_now_and_then(const z_loaned_session_t *session) {
    z_view_keyexpr_t rig;
    z_owned_closure_reply_t then;
    lock();
    const int64_t now = now_ns();
    const bool is_time = !robot.asking && (robot.asked_ns == 0 || now - robot.asked_ns >= ASK_EVERY_NS);
    if (is_time) {
        robot.asking = true;
        robot.asked_ns = now;
    }
    unlock();
    if (!is_time) return;
    z_view_keyexpr_from_str(&rig, "asterism/" CAMERA "/rig");
    z_closure_reply(&then, on_answer, on_last_answer, NULL);
    z_get(session, z_view_keyexpr_loan(&rig), "", z_closure_reply_move(&then), NULL);
}
#else
static void ask_now_and_then(const z_loaned_session_t *session) { (void)session; }
#endif

/* Drive or stop; `said` is why the robot stands, NULL while it drives. */
static const char *step(const char *said) {
    static asterism_odometry pose;
    lock();
    const int64_t now = now_ns();
    const int64_t age_ns = robot.has_pose ? asterism_age_ns(&robot.clock, &robot.pose, now) : ASTERISM_UNKNOWN;
    const bool is_heard = asterism_is_heard(&robot.clock, now), is_known = robot.clock.heard_ns != 0;
    const asterism_error refused = robot.refused;
    pose = robot.pose;
    unlock();
    if (age_ns <= MOST_AGE_NS) {
        drive(&pose, age_ns);
        return NULL;
    }
    const char *why = refused ? asterism_words(refused) : "no pose of the last 0.1 s";
    if (!is_heard) why = is_known ? "the server has stopped answering" : "nothing was heard of a server yet";
    if (why != said) stop(why);
    return why;
}

static bool subscribe(const z_loaned_session_t *session, const char *key, void (*call)(z_loaned_sample_t *, void *)) {
    z_view_keyexpr_t expression;
    z_owned_closure_sample_t then;
    if (z_view_keyexpr_from_str(&expression, key) != Z_OK) return false;
    z_closure_sample(&then, call, NULL, NULL);
    const z_loaned_keyexpr_t *where = z_view_keyexpr_loan(&expression);
    return z_declare_background_subscriber(session, where, z_closure_sample_move(&then), NULL) == Z_OK;
}

/* As a client of that server: nobody is sought by multicast. */
static bool connect_to(const char *endpoint, z_owned_session_t *session) {
    z_owned_config_t config;
    z_config_default(&config);
    zp_config_insert(z_config_loan_mut(&config), Z_CONFIG_MODE_KEY, Z_CONFIG_MODE_CLIENT);
    zp_config_insert(z_config_loan_mut(&config), Z_CONFIG_CONNECT_KEY, endpoint);
    zp_config_insert(z_config_loan_mut(&config), Z_CONFIG_MULTICAST_SCOUTING_KEY, "false");
    return z_open(session, z_config_move(&config), NULL) == Z_OK;
}

/* Does not come back unless a key is none. */
int robot_run(const char *endpoint) {
    z_owned_session_t session;
    begin();
    asterism_clock_start(&robot.clock, true);
    for (bool said = false; !connect_to(endpoint, &session); said = true) {
        if (!said) stop("no server yet");
        z_sleep_s(1);
    }
    const z_loaned_session_t *loaned = z_session_loan(&session);
    if (!subscribe(loaned, "asterism/" CAMERA "/robot/" ROBOT "/odometry", on_pose) ||
        !subscribe(loaned, "asterism/" CAMERA "/beat", on_beat)) {
        stop("its keys are none");
        return 2;
    }
    for (const char *said = "";;) {
#if Z_FEATURE_MULTI_THREAD == 0
        for (int k = 0; k < 32 && zp_spin_once(loaned); k++) {
        }
#endif
        ask_now_and_then(loaned);
        said = step(said);
        z_sleep_ms(LOOP_MS);
    }
}

#ifndef ASTERISM_NO_MAIN
int main(int count, char **words) { return robot_run(count > 1 ? words[1] : ENDPOINT); }
#endif
