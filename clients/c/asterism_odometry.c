#include "asterism_odometry.h"

#include <string.h>

#define MOST ((asterism_real)1e9)          /* m, px, m/s, rad/s */
#define MOST_VARIANCE ((asterism_real)1e18)
#define NEAR_UNIT ((asterism_real)1e-3)    /* of a quaternion's length */
#ifdef ASTERISM_FLOAT
#define UNEVEN ((asterism_real)1e-5)       /* of a covariance's two halves, as a correlation */
#else
#define UNEVEN ((asterism_real)1e-6)
#endif
#define SECOND_NS 1000000000
#define LONGEST_NS ((int64_t)600 * SECOND_NS) /* from exposure to publishing */

/* The metadata that are read, in the order of KEYS. */
enum { STATE, LEDS, RMS_PX, SEQUENCE, SESSION, PUBLISHED_NS, SMOOTHED, EXTRAPOLATED, ACCELERATION, TURN, CAMERAS, KEYS };
enum { NEEDED = SEQUENCE + 1 };

typedef struct {
    asterism_odometry *pose;
    asterism_span values[KEYS]; /* of the message; empty where there are none */
    bool there[KEYS];
    int64_t seconds;
    int32_t nanos;
    unsigned numbers[2]; /* of both covariances */
} reading;

typedef char fits_in_four_kilobytes[sizeof(asterism_odometry) + sizeof(reading) + 512 < 4096 ? 1 : -1];

/* Messages within the message. A field that is there twice: the last holds. */

static asterism_error read_reals(asterism_span rest, unsigned count, asterism_real *reals) {
    asterism_field field;
    while (rest.at != rest.end) {
        const asterism_error error = asterism_next(&rest, &field);
        if (error) return error;
        if (field.type == ASTERISM_EIGHT && field.number <= count) reals[field.number - 1] = asterism_real_of(field.value);
    }
    return ASTERISM_OK;
}

static asterism_error read_time(asterism_span rest, reading *to) {
    asterism_field field;
    while (rest.at != rest.end) {
        const asterism_error error = asterism_next(&rest, &field);
        if (error) return error;
        if (field.type != ASTERISM_WHOLE) continue;
        if (field.number == 1) to->seconds = (int64_t)field.value;
        if (field.number == 2) to->nanos = (int32_t)(uint32_t)field.value;
    }
    return ASTERISM_OK;
}

static asterism_error read_pose(asterism_span rest, reading *to) {
    asterism_field field;
    while (rest.at != rest.end) {
        asterism_error error = asterism_next(&rest, &field);
        if (error) return error;
        if (field.type != ASTERISM_BYTES) continue;
        if (field.number == 1) error = read_reals(field.bytes, 3, to->pose->position);
        if (field.number == 2) error = read_reals(field.bytes, 4, to->pose->orientation);
        if (error) return error;
    }
    return ASTERISM_OK;
}

static asterism_error read_name(asterism_span text, char *name) {
    const size_t length = (size_t)(text.end - text.at);
    if (!asterism_is_text(text)) return ASTERISM_TEXT;
    if (length > ASTERISM_LONGEST_NAME || (length && memchr(text.at, 0, length))) return ASTERISM_NAME;
    memset(name, 0, ASTERISM_LONGEST_NAME + 1);
    if (length) memcpy(name, text.at, length);
    return ASTERISM_OK;
}

static bool is(asterism_span text, const char *word) {
    const size_t length = strlen(word);
    return (size_t)(text.end - text.at) == length && (length == 0 || memcmp(text.at, word, length) == 0);
}

static void keep(asterism_span key, asterism_span value, reading *to) {
    static const char *const keys[KEYS] = {"state",        "leds",     "rms_px",       "sequence",     "session",
                                           "published_ns", "smoothed", "extrapolated", "acceleration", "turn_acceleration",
                                           "cameras"};
    for (int k = 0; k < KEYS; k++) {
        if (!is(key, keys[k])) continue;
        to->values[k] = value;
        to->there[k] = true;
    }
}

static asterism_error read_pair(asterism_span rest, reading *to) {
    asterism_span key = {rest.at, rest.at}, value = key;
    asterism_field field;
    while (rest.at != rest.end) {
        const asterism_error error = asterism_next(&rest, &field);
        if (error) return error;
        if (field.type != ASTERISM_BYTES || field.number > 2) continue;
        if (!asterism_is_text(field.bytes)) return ASTERISM_TEXT;
        if (field.number == 1) key = field.bytes;
        if (field.number == 2) value = field.bytes;
    }
    keep(key, value, to);
    return ASTERISM_OK;
}

/* A list of numbers: packed, one by one, or both, of which all count. */
static asterism_error read_list(const asterism_field *field, unsigned *count, asterism_real *reals) {
    asterism_span rest = field->bytes;
    if (field->type == ASTERISM_EIGHT) {
        if (*count < 36) reals[*count] = asterism_real_of(field->value);
        *count += *count <= 36;
        return ASTERISM_OK;
    }
    if (field->type != ASTERISM_BYTES) return ASTERISM_OK;
    if ((rest.end - rest.at) % 8) return ASTERISM_PACKED;
    for (; rest.at != rest.end && *count <= 36; rest.at += 8, ++*count) {
        uint64_t bits = 0;
        for (int k = 0; k < 8; k++) bits |= (uint64_t)rest.at[k] << (8 * k);
        if (*count < 36) reals[*count] = asterism_real_of(bits);
    }
    return ASTERISM_OK;
}

static asterism_error read_field(const asterism_field *field, reading *to) {
    asterism_odometry *pose = to->pose;
    if (field->number == 7) return read_list(field, &to->numbers[0], pose->covariance);
    if (field->number == 8) return read_list(field, &to->numbers[1], pose->velocity_covariance);
    if (field->type != ASTERISM_BYTES) return ASTERISM_OK;
    switch (field->number) {
        case 1: return read_time(field->bytes, to);
        case 2: return read_name(field->bytes, pose->frame_id);
        case 3: return read_name(field->bytes, pose->robot);
        case 4: return read_pose(field->bytes, to);
        case 5: return read_reals(field->bytes, 3, pose->linear);
        case 6: return read_reals(field->bytes, 3, pose->angular);
        case 9: return read_pair(field->bytes, to);
        default: return ASTERISM_OK; /* of a newer version */
    }
}

static asterism_error read_message(asterism_span rest, reading *to) {
    asterism_field field;
    while (rest.at != rest.end) {
        asterism_error error = asterism_next(&rest, &field);
        if (!error) error = read_field(&field, to);
        if (error) return error;
    }
    return ASTERISM_OK;
}

/* What the metadata say. */

static bool read_whole(const reading *from, int key, uint64_t *number) {
    *number = 0;
    return !from->there[key] || asterism_whole_number(from->values[key], number);
}

static bool read_real(const reading *from, int key, asterism_real *number) {
    *number = 0;
    return !from->there[key] || asterism_real_number(from->values[key], number);
}

static asterism_error read_metadata(reading *from) {
    asterism_odometry *pose = from->pose;
    uint64_t leds, published_ns;
    for (int k = 0; k < NEEDED; k++) {
        if (!from->there[k]) return ASTERISM_METADATA;
    }
    if (!read_whole(from, LEDS, &leds) || !read_whole(from, SEQUENCE, &pose->sequence) ||
        !read_whole(from, SESSION, &pose->session) || !read_whole(from, PUBLISHED_NS, &published_ns) ||
        !read_real(from, RMS_PX, &pose->rms_px))
        return ASTERISM_NUMBER;
    if (is(from->values[STATE], "TRACKED")) pose->state = ASTERISM_TRACKED;
    if (is(from->values[STATE], "TILT_AMBIGUOUS")) pose->state = ASTERISM_TILT_AMBIGUOUS;
    if (pose->state == 0) return ASTERISM_STATE;
    /* Several cameras may each see the same three. */
    const bool fused = from->there[CAMERAS] && !is(from->values[CAMERAS], "[]");
    if (leds < (fused ? 3u : 4u) || leds > 6) return ASTERISM_LEDS;
    pose->leds = (uint8_t)leds;
    pose->smoothed = is(from->values[SMOOTHED], "true");
    pose->extrapolated = is(from->values[EXTRAPOLATED], "true");
    pose->published_ns = published_ns < (uint64_t)ASTERISM_LATEST_NS ? (int64_t)published_ns : ASTERISM_LATEST_NS;
    return ASTERISM_OK;
}

/* What a robot may drive by. Every comparison is written so that no number that is none passes it. */

static bool is_within(const asterism_real *numbers, int count, asterism_real most) {
    for (int k = 0; k < count; k++) {
        if (!(numbers[k] >= -most && numbers[k] <= most)) return false;
    }
    return true;
}

/* Symmetric, no correlation beyond 1: both but for rounding. */
static bool is_even(const asterism_real *matrix, int i, int j) {
    const asterism_real a = matrix[7 * i], b = matrix[7 * j];
    const asterism_real one = matrix[6 * i + j], apart = one - matrix[6 * j + i];
    return (one / a) * (one / b) <= (1 + UNEVEN) * (1 + UNEVEN) && (apart / a) * (apart / b) <= UNEVEN * UNEVEN;
}

/* Variances above 0 in every direction, but for rounding: those of L D L' are. */
static bool is_covariance(const asterism_real *matrix) {
    asterism_real lower[6][6], left[6];
    for (int i = 0; i < 6; i++) {
        if (!(matrix[7 * i] > 0)) return false;
        left[i] = matrix[7 * i] * (1 + UNEVEN);
        for (int j = 0; j < i; j++) {
            if (!is_even(matrix, i, j)) return false;
            asterism_real told = matrix[6 * i + j];
            for (int k = 0; k < j; k++) told -= lower[i][k] * left[k] * lower[j][k];
            lower[i][j] = told / left[j];
        }
        for (int j = 0; j < i; j++) left[i] -= lower[i][j] * lower[i][j] * left[j];
        if (!(left[i] > 0)) return false;
    }
    return true;
}

static bool is_motion(const asterism_odometry *pose) {
    return is_within(pose->linear, 3, MOST) && is_within(pose->angular, 3, MOST) &&
           is_within(pose->velocity_covariance, 36, MOST_VARIANCE) && is_covariance(pose->velocity_covariance) &&
           is_within(&pose->acceleration, 1, MOST) && is_within(&pose->turn_acceleration, 1, MOST);
}

static asterism_error check_motion(const reading *from) {
    asterism_odometry *pose = from->pose;
    pose->has_velocity = from->numbers[1] != 0;
    if (!pose->has_velocity) { /* vectors without a covariance are none */
        memset(pose->linear, 0, sizeof pose->linear);
        memset(pose->angular, 0, sizeof pose->angular);
        return ASTERISM_OK;
    }
    if (!read_real(from, ACCELERATION, &pose->acceleration) || !read_real(from, TURN, &pose->turn_acceleration))
        return ASTERISM_NUMBER;
    return from->numbers[1] == 36 && is_motion(pose) ? ASTERISM_OK : ASTERISM_VELOCITY;
}

static bool is_unit(const asterism_real *q) {
    const asterism_real square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    return square >= (1 - NEAR_UNIT) * (1 - NEAR_UNIT) && square <= (1 + NEAR_UNIT) * (1 + NEAR_UNIT);
}

static asterism_error check_times(const reading *from) {
    asterism_odometry *pose = from->pose;
    if (from->seconds < 0 || from->seconds >= ASTERISM_LATEST_NS / SECOND_NS) return ASTERISM_TIMES;
    if (from->nanos < 0 || from->nanos >= SECOND_NS) return ASTERISM_TIMES;
    pose->exposed_ns = from->seconds * SECOND_NS + from->nanos;
    if (pose->exposed_ns == 0 || pose->published_ns >= ASTERISM_LATEST_NS) return ASTERISM_TIMES;
    const int64_t took_ns = pose->published_ns - pose->exposed_ns;
    return took_ns < 0 || took_ns > LONGEST_NS ? ASTERISM_TIMES : ASTERISM_OK;
}

static asterism_error check(const reading *from, const char *robot) {
    asterism_odometry *pose = from->pose;
    if (robot && strcmp(robot, pose->robot) != 0) return ASTERISM_ROBOT;
    if (!is_within(pose->position, 3, MOST)) return ASTERISM_POSITION;
    if (!is_unit(pose->orientation)) return ASTERISM_ORIENTATION;
    if (!is_within(&pose->rms_px, 1, MOST)) return ASTERISM_RESIDUALS;
    if (from->numbers[0] != 36 || !is_within(pose->covariance, 36, MOST_VARIANCE) || !is_covariance(pose->covariance))
        return ASTERISM_COVARIANCE;
    const asterism_error error = check_motion(from);
    return error ? error : check_times(from);
}

asterism_error asterism_read_odometry(const uint8_t *message, size_t size, const char *robot, asterism_odometry *pose) {
    reading from;
    memset(pose, 0, sizeof *pose);
    memset(&from, 0, sizeof from);
    from.pose = pose;
    const asterism_span all = {message, size ? message + size : message};
    asterism_error error = read_message(all, &from);
    if (!error) error = read_metadata(&from);
    if (!error) error = check(&from, robot);
    if (error) memset(pose, 0, sizeof *pose);
    return error;
}
