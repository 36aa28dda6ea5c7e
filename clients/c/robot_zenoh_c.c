/* A robot that drives by Asterism's poses and stops without them, with zenoh-c 1.x (Linux, macOS).
 *
 *     robot_zenoh_c [ROBOT [ENDPOINT [CAMERA]]]        alpha tcp/127.0.0.1:7447 '*'
 *
 * README.md beside this file says how to build it. `drive` and `stop` are yours. Where several cameras see the robot,
 * name one, or keep a clock for each. SPDX-License-Identifier: Apache-2.0
 */
#define _POSIX_C_SOURCE 200809L
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <zenoh.h>

#include "asterism_clock.h"

#define MOST_AGE_NS 100000000 /* older poses are not driven by */
#define LOOP_MS 10
#define ASK_EVERY_NS 10000000000 /* for the server's clock, */
#define ASK_SOON_NS 200000000    /* while it is not known; */
#define ASK_AGAIN 5              /* and so often where an answer took long, */
#define LONG_NS 5000000          /* so that poses look older by that */

static struct {
    pthread_mutex_t lock; /* zenoh calls from its own threads */
    const char *robot;
    asterism_clock clock;
    asterism_odometry pose; /* the newest */
    bool has_pose;
    asterism_error refused; /* why the newest message was, for people */
    int quick;              /* questions to be asked soon, as the server's clock is not known, or not well */
} robot = {.lock = PTHREAD_MUTEX_INITIALIZER};

static volatile sig_atomic_t ended;

static void end(int number) {
    (void)number;
    ended = 1;
}

/* A clock that nobody sets, and that goes on while the machine sleeps, where there is one. */
static int64_t now_ns(void) {
    struct timespec now;
#ifdef CLOCK_BOOTTIME
    clock_gettime(CLOCK_BOOTTIME, &now);
#else
    clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void drive(const asterism_odometry *pose, int64_t age_ns) {
    static int64_t said_ns;
    if (now_ns() - said_ns < 200000000) return;
    said_ns = now_ns();
    printf("%s at %.4f %.4f %.4f m in %s, %.1f ms old, %d LEDs%s\n", pose->robot, (double)pose->position[0],
           (double)pose->position[1], (double)pose->position[2], pose->frame_id, (double)age_ns * 1e-6, pose->leds,
           pose->state == ASTERISM_TILT_AMBIGUOUS ? ", tilt ambiguous" : "");
    fflush(stdout);
}

static void stop(const char *why) {
    printf("stop: %s\n", why);
    fflush(stdout);
}

/* The bytes of a sample, if they fit: how many. */
static size_t payload(const z_loaned_sample_t *sample, uint8_t *bytes, size_t room) {
    const z_loaned_bytes_t *all = z_sample_payload(sample);
    z_bytes_reader_t reader = z_bytes_get_reader(all);
    return z_bytes_len(all) <= room ? z_bytes_reader_read(&reader, bytes, room) : 0;
}

static void on_pose(z_loaned_sample_t *sample, void *unused) {
    const int64_t received_ns = now_ns();
    uint8_t bytes[ASTERISM_LONGEST_MESSAGE];
    asterism_odometry pose;
    (void)unused;
    asterism_error error = asterism_read_odometry(bytes, payload(sample, bytes, sizeof bytes), robot.robot, &pose);
    pthread_mutex_lock(&robot.lock);
    if (!error) error = asterism_clock_pose(&robot.clock, &pose, received_ns);
    if (!error) {
        robot.pose = pose;
        robot.has_pose = true;
    }
    robot.refused = error;
    pthread_mutex_unlock(&robot.lock);
}

static void on_beat(z_loaned_sample_t *sample, void *unused) {
    const int64_t received_ns = now_ns();
    uint8_t bytes[256];
    asterism_time told;
    (void)unused;
    if (asterism_read_beat(bytes, payload(sample, bytes, sizeof bytes), &told)) return;
    pthread_mutex_lock(&robot.lock);
    asterism_clock_beat(&robot.clock, &told, received_ns);
    pthread_mutex_unlock(&robot.lock);
}

/* The server's answer for its rig, of which the clock is wanted; `asked` is when it was asked. */
static void on_answer(z_loaned_reply_t *reply, void *asked) {
    const int64_t answered_ns = now_ns();
    z_owned_slice_t rig;
    asterism_time told;
    if (!z_reply_is_ok(reply) || z_bytes_to_slice(z_sample_payload(z_reply_ok(reply)), &rig) != Z_OK) return;
    const z_loaned_slice_t *bytes = z_slice_loan(&rig);
    if (!asterism_read_rig_time(z_slice_data(bytes), z_slice_len(bytes), &told)) {
        pthread_mutex_lock(&robot.lock);
        asterism_clock_answer(&robot.clock, &told, *(int64_t *)asked, answered_ns);
        robot.quick = answered_ns - *(int64_t *)asked > LONG_NS ? robot.quick - 1 : 0;
        pthread_mutex_unlock(&robot.lock);
    }
    z_slice_drop(z_slice_move(&rig));
}

static void ask(const z_loaned_session_t *session, const char *key) {
    int64_t *asked = malloc(sizeof *asked); /* zenoh gives it to `free` after the last answer */
    z_view_keyexpr_t rig;
    z_owned_closure_reply_t then;
    if (asked == NULL || z_view_keyexpr_from_str(&rig, key) != Z_OK) {
        free(asked);
        return;
    }
    *asked = now_ns();
    z_closure_reply(&then, on_answer, free, asked);
    z_get(session, z_view_keyexpr_loan(&rig), "", z_closure_reply_move(&then), NULL);
}

/* Drive or stop; `said` is why the robot stands, NULL while it drives. */
static const char *step(const char *said) {
    pthread_mutex_lock(&robot.lock);
    const int64_t now = now_ns();
    const int64_t age_ns = robot.has_pose ? asterism_age_ns(&robot.clock, &robot.pose, now) : ASTERISM_UNKNOWN;
    const bool is_heard = asterism_is_heard(&robot.clock, now), is_known = robot.clock.heard_ns != 0;
    const asterism_odometry pose = robot.pose;
    const asterism_error refused = robot.refused;
    pthread_mutex_unlock(&robot.lock);
    if (age_ns <= MOST_AGE_NS) {
        drive(&pose, age_ns);
        return NULL;
    }
    const char *why = refused ? asterism_words(refused) : "no pose of the last 0.1 s";
    if (!is_heard) why = is_known ? "the server has stopped answering" : "nothing was heard of a server yet";
    if (why != said) stop(why);
    return why;
}

static bool is_time_to_ask(int64_t asked_ns) {
    pthread_mutex_lock(&robot.lock);
    if (!robot.clock.most.known) robot.quick = ASK_AGAIN;
    const int64_t pause_ns = robot.quick > 0 ? ASK_SOON_NS : ASK_EVERY_NS;
    pthread_mutex_unlock(&robot.lock);
    return now_ns() - asked_ns >= pause_ns;
}

static bool subscribe(const z_loaned_session_t *session, const char *key, void (*call)(z_loaned_sample_t *, void *)) {
    z_view_keyexpr_t expression;
    z_owned_closure_sample_t then;
    if (z_view_keyexpr_from_str(&expression, key) != Z_OK) return false;
    z_closure_sample(&then, call, NULL, NULL);
    const z_loaned_keyexpr_t *where = z_view_keyexpr_loan(&expression);
    return z_declare_background_subscriber(session, where, z_closure_sample_move(&then), NULL) == Z_OK;
}

/* As a client of that server alone: it is found again when it comes back, and nobody is sought by multicast. */
static bool connect_to(const char *endpoint, z_owned_session_t *session) {
    z_owned_config_t config;
    char list[256];
    snprintf(list, sizeof list, "[\"%s\"]", endpoint);
    z_config_default(&config);
    z_loaned_config_t *loaned = z_config_loan_mut(&config);
    if (zc_config_insert_json5(loaned, "mode", "\"client\"") != Z_OK ||
        zc_config_insert_json5(loaned, "connect/endpoints", list) != Z_OK ||
        zc_config_insert_json5(loaned, "scouting/multicast/enabled", "false") != Z_OK) {
        z_config_drop(z_config_move(&config));
        return false;
    }
    return z_open(session, z_config_move(&config), NULL) == Z_OK;
}

int main(int count, char **words) {
    const char *endpoint = count > 2 ? words[2] : "tcp/127.0.0.1:7447", *camera = count > 3 ? words[3] : "*";
    char poses[400], beats[200], rig[200];
    z_owned_session_t session;
    robot.robot = count > 1 ? words[1] : "alpha";
    asterism_clock_start(&robot.clock, false);
    snprintf(poses, sizeof poses, "asterism/%s/robot/%s/odometry", camera, robot.robot);
    snprintf(beats, sizeof beats, "asterism/%s/beat", camera);
    snprintf(rig, sizeof rig, "asterism/%s/rig", camera);
    signal(SIGINT, end);
    signal(SIGTERM, end);
    for (bool said = false; !connect_to(endpoint, &session); said = true) {
        if (!said) stop("no server yet");
        if (ended) return 0;
        nanosleep(&(struct timespec){1, 0}, NULL);
    }
    const z_loaned_session_t *loaned = z_session_loan(&session);
    if (!subscribe(loaned, poses, on_pose) || !subscribe(loaned, beats, on_beat)) {
        fprintf(stderr, "%s is no key\n", poses);
        return 2;
    }
    int64_t asked_ns = -ASK_EVERY_NS;
    for (const char *said = ""; !ended;) {
        if (is_time_to_ask(asked_ns)) {
            asked_ns = now_ns();
            ask(loaned, rig);
        }
        said = step(said);
        nanosleep(&(struct timespec){0, LOOP_MS * 1000000}, NULL);
    }
    stop("the program ends");
    z_session_drop(z_session_move(&session));
    return 0;
}
