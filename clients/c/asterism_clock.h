/* How old a pose is by its server's clock, as far as this board can know that clock: the law of clients/age.py.
 *
 * Clocks of two machines have nothing in common but their pace, and that within 200 ppm. What is known of the server's
 * clock are two bounds: it had reached a stamp when the stamp arrived, and it had not passed the time that it told in
 * an answer when the question went out. Times of this board are ns of a monotonic clock that nobody sets, from 0 to
 * 2^61. One asterism_clock per camera; where two threads use it, lock it.
 */
#ifndef ASTERISM_CLOCK_H
#define ASTERISM_CLOCK_H

#include "asterism_odometry.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ASTERISM_UNKNOWN INT64_MAX         /* an age while nothing is known of the server's clock */
#define ASTERISM_SILENT_NS 800000000       /* four beats: a server that sent nothing for so long has stopped answering */

typedef struct {
    uint64_t session;
    int64_t time_ns; /* the server's clock */
} asterism_time;

/* A server's clock, out of an asterism.Beat or of an asterism.RigReport. What else they tell is not looked at. Refused
 * where it does not run at the pace of clocks: the replay of a recording, slower or faster. */
asterism_error asterism_read_beat(const uint8_t *message, size_t size, asterism_time *time);
asterism_error asterism_read_rig_time(const uint8_t *message, size_t size, asterism_time *time);

typedef struct {
    int64_t offset_ns; /* server's clock less this board's */
    int64_t at_ns;     /* this board's */
    bool known;
} asterism_bound;

typedef struct {
    uint64_t session;
    bool told;  /* the server told its session: poses of another are refused */
    bool alone; /* until the server answered, ages rest on the least delay that was seen */
    asterism_bound least, most;
    int64_t exposed_ns; /* of the newest pose; 0: none yet */
    int64_t heard_ns;   /* when something of the server came last; 0: nothing yet */
} asterism_clock;

/* Nothing is known. `alone`: ages are told without an answer of the server too, where nobody asks it, or where its answer
 * may not come. They are right once something has come without waiting on its way, and too fresh before. */
void asterism_clock_start(asterism_clock *clock, bool alone);

/* A beat arrived. */
void asterism_clock_beat(asterism_clock *clock, const asterism_time *told, int64_t received_ns);

/* The server was asked for its rig, and answered. */
void asterism_clock_answer(asterism_clock *clock, const asterism_time *told, int64_t asked_ns, int64_t answered_ns);

/* A pose arrived that asterism_read_odometry took: whether it may be driven by, or why not. */
asterism_error asterism_clock_pose(asterism_clock *clock, const asterism_odometry *pose, int64_t received_ns);

/* ns since mid-exposure of a pose of that session, by the server's clock; ASTERISM_UNKNOWN while nothing is known of
 * it, or of that session no more. With answers never fresher than the truth by more than 5 ms. */
int64_t asterism_age_ns(const asterism_clock *clock, const asterism_odometry *pose, int64_t now_ns);

/* Whether the server sent something within ASTERISM_SILENT_NS. Means something where its beats are subscribed to. */
bool asterism_is_heard(const asterism_clock *clock, int64_t now_ns);

#ifdef __cplusplus
}
#endif

#endif
