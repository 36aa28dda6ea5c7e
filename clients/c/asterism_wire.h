/* Protobuf's wire format as Asterism's messages use it, field by field: no allocation, no recursion, no library.
 * https://protobuf.dev/programming-guides/encoding
 */
#ifndef ASTERISM_WIRE_H
#define ASTERISM_WIRE_H

#include <float.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What numbers are kept in. Define ASTERISM_FLOAT for every file, or none, on a board whose processor has no doubles:
 * messages are read without any arithmetic of doubles then. A pose at 10 m is kept to 0.5 um. */
#if !defined(ASTERISM_FLOAT) && DBL_MANT_DIG < 53
#define ASTERISM_FLOAT /* AVR: a double is a float there */
#endif
#ifdef ASTERISM_FLOAT
typedef float asterism_real;
#else
typedef double asterism_real;
#endif

typedef enum {
    ASTERISM_OK = 0,
    /* These bytes are no message. */
    ASTERISM_TRUNCATED,
    ASTERISM_VARINT,
    ASTERISM_FIELD,
    ASTERISM_GROUP,
    ASTERISM_TEXT,
    ASTERISM_PACKED,
    /* They are a message, but no pose of Asterism. */
    ASTERISM_METADATA,
    ASTERISM_NUMBER,
    ASTERISM_NAME,
    ASTERISM_ROBOT,
    ASTERISM_STATE,
    ASTERISM_LEDS,
    ASTERISM_POSITION,
    ASTERISM_ORIENTATION,
    ASTERISM_RESIDUALS,
    ASTERISM_COVARIANCE,
    ASTERISM_VELOCITY,
    ASTERISM_TIMES,
    /* A beat or a rig report. */
    ASTERISM_SESSION,
    ASTERISM_RATE,
    /* A pose that asterism_clock does not take. */
    ASTERISM_OTHER_SESSION,
    ASTERISM_ORDER,
    ASTERISM_FUTURE,
    ASTERISM_ERRORS /* how many there are */
} asterism_error;

/* Times from here on are refused, the year 2116: sums and differences of all others fit 64 bits. */
#define ASTERISM_LATEST_NS ((int64_t)1 << 62)

/* What is wrong, in words that follow "the message ". */
const char *asterism_words(asterism_error error);

/* Bytes of the message that are still to be read. */
typedef struct {
    const uint8_t *at, *end;
} asterism_span;

typedef enum { ASTERISM_WHOLE = 0, ASTERISM_EIGHT = 1, ASTERISM_BYTES = 2, ASTERISM_FOUR = 5 } asterism_type;

typedef struct {
    uint32_t number;
    uint8_t type;        /* asterism_type */
    uint64_t value;      /* of ASTERISM_WHOLE, ASTERISM_EIGHT, ASTERISM_FOUR */
    asterism_span bytes; /* of ASTERISM_BYTES */
} asterism_field;

/* The next field, taken off the span, which must not be empty. */
asterism_error asterism_next(asterism_span *rest, asterism_field *field);

/* Whether that is UTF-8, as protobuf's strings must be. */
bool asterism_is_text(asterism_span text);

/* The number that eight bytes of the wire hold. */
asterism_real asterism_real_of(uint64_t bits);

/* Digits, up to 20 of them: false for anything else, and for more than 64 bits. */
bool asterism_whole_number(asterism_span text, uint64_t *number);

/* Digits with a point and an exponent, up to 40 characters, without a sign; false for anything else.
 * Right to the last bit for five digits and exponents of 10 (double: 15 digits, 22), else to some 20 roundings. */
bool asterism_real_number(asterism_span text, asterism_real *number);

#ifdef __cplusplus
}
#endif

#endif
