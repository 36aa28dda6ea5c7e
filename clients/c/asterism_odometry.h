/* A robot's pose out of the bytes of a foxglove.Odometry message, as Asterism fills it.
 *
 * Needs no protobuf library, no heap, no libm. SPDX-License-Identifier: Apache-2.0
 */
#ifndef ASTERISM_ODOMETRY_H
#define ASTERISM_ODOMETRY_H

#include "asterism_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ASTERISM_LONGEST_NAME 128 /* bytes, of a camera or robot */
#define ASTERISM_LONGEST_MESSAGE 1536 /* bytes: a pose with velocities and the longest names has 1300 */

/* TILT_AMBIGUOUS: the position is good, the tilt may be the other of two. */
enum { ASTERISM_TRACKED = 1, ASTERISM_TILT_AMBIGUOUS = 2 };

/* SI units, ns since the Unix epoch by the server's clock. Covariances are 6x6, row by row: x, y, z, rotation about the
 * x, y, z axes of the parent frame. */
typedef struct {
    int64_t exposed_ns;       /* mid-exposure: when the robot was there */
    int64_t published_ns;     /* when the server told it */
    uint64_t session;         /* stamps of two sessions are not to be compared; 0 of a server of version 0.1 */
    uint64_t sequence;        /* the frame's number */
    asterism_real position[3];    /* m, of the robot in frame_id */
    asterism_real orientation[4]; /* x y z w, of the robot in frame_id; of unit length to 0.001 */
    asterism_real covariance[36];
    asterism_real rms_px;         /* residuals of the LEDs */
    asterism_real linear[3];      /* the rest only where has_velocity: m/s, of the robot's origin, in its own frame */
    asterism_real angular[3];     /* rad/s, in the robot's own frame */
    asterism_real velocity_covariance[36];
    asterism_real acceleration, turn_acceleration; /* white, that the filter takes for possible: m2/s3, rad2/s3 */
    char frame_id[ASTERISM_LONGEST_NAME + 1];      /* "world", or the camera's name */
    char robot[ASTERISM_LONGEST_NAME + 1];
    uint8_t state;     /* ASTERISM_TRACKED or ASTERISM_TILT_AMBIGUOUS */
    uint8_t leds;      /* 4 to 6 that it rests on; 3 to 6 where several cameras are joined */
    bool smoothed;     /* joined with the frames before */
    bool extrapolated; /* the rig corrects Z, and no surveyed pose was near */
    bool has_velocity;
} asterism_odometry;

/* Read a message, and refuse whatever is no pose that a robot may drive by: see asterism_words.
 *
 * `robot`: the id that it must be of, as in its key; NULL takes any. What is refused leaves `pose` all zero. */
asterism_error asterism_read_odometry(const uint8_t *message, size_t size, const char *robot, asterism_odometry *pose);

#ifdef __cplusplus
}
#endif

#endif
