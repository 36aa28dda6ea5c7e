#include "asterism_wire.h"

#include <string.h>

enum { TAG_BYTES = 5, LENGTH_BYTES = 5, VALUE_BYTES = 10 };
enum { LONGEST_WHOLE = 20, LONGEST_REAL = 40, LARGEST_POWER = 60 };

const char *asterism_words(asterism_error error) {
    static const char *const words[ASTERISM_ERRORS] = {
        "is good",
        "ends within a field",
        "has a whole number that does not end, or a tag or length that is too large",
        "has a field of number 0, or of a type that there is not",
        "has a group, which nobody writes any more",
        "has text that is not UTF-8",
        "has a list of numbers of which one is cut off",
        "lacks state, leds, rms_px or sequence",
        "has metadata with a number that is none",
        "has a name of more than 128 bytes, or with a NUL in it",
        "is of another robot",
        "has a state that is neither TRACKED nor TILT_AMBIGUOUS",
        "rests on fewer than 4 or more than 6 LEDs",
        "has a position that is not finite, or beyond 1e9 m",
        "has an orientation that is not of unit length",
        "has residuals beyond 1e9 px",
        "has a covariance that is none",
        "has a velocity that is none",
        "has times that cannot be",
        "is of no session",
        "is of a replay that does not run at the speed of the clock",
        "is of a session that the server did not tell of",
        "is older than the one before, or the same",
        "was published later than now",
    };
    return (unsigned)error < ASTERISM_ERRORS ? words[error] : "has an error that is none";
}

static asterism_error varint(asterism_span *rest, int most_bytes, uint64_t *value) {
    *value = 0;
    for (int k = 0; k < most_bytes; k++) {
        if (rest->at == rest->end) return ASTERISM_TRUNCATED;
        const uint8_t byte = *rest->at++;
        *value |= (uint64_t)(byte & 0x7F) << (7 * k); /* of the tenth byte one bit counts */
        if (byte < 0x80) return ASTERISM_OK;
    }
    return ASTERISM_VARINT;
}

static asterism_error fixed(asterism_span *rest, int count, uint64_t *value) {
    if (rest->end - rest->at < count) return ASTERISM_TRUNCATED;
    *value = 0;
    for (int k = 0; k < count; k++) *value |= (uint64_t)rest->at[k] << (8 * k);
    rest->at += count;
    return ASTERISM_OK;
}

static asterism_error bytes(asterism_span *rest, asterism_span *part) {
    uint64_t length;
    const asterism_error error = varint(rest, LENGTH_BYTES, &length);
    if (error) return error;
    if (length > (uint64_t)(rest->end - rest->at)) return ASTERISM_TRUNCATED;
    part->at = rest->at;
    part->end = rest->at += (size_t)length;
    return ASTERISM_OK;
}

asterism_error asterism_next(asterism_span *rest, asterism_field *field) {
    uint64_t tag;
    const asterism_error error = varint(rest, TAG_BYTES, &tag);
    if (error) return error;
    if (tag > UINT32_MAX) return ASTERISM_VARINT;
    field->number = (uint32_t)tag >> 3;
    field->type = (uint8_t)(tag & 7);
    if (field->number == 0) return ASTERISM_FIELD;
    switch (field->type) {
        case ASTERISM_WHOLE: return varint(rest, VALUE_BYTES, &field->value);
        case ASTERISM_EIGHT: return fixed(rest, 8, &field->value);
        case ASTERISM_BYTES: return bytes(rest, &field->bytes);
        case ASTERISM_FOUR: return fixed(rest, 4, &field->value);
        case 3:
        case 4: return ASTERISM_GROUP;
        default: return ASTERISM_FIELD;
    }
}

/* How many bytes follow the first of a character, the least and the most that the next may be; -1 for none. */
static int more_bytes(uint8_t first, uint8_t *least, uint8_t *most) {
    *least = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80; /* a shorter way would do */
    *most = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;  /* a surrogate; beyond the last */
    if (first < 0x80) return 0;
    if (first < 0xC2) return -1;
    if (first < 0xE0) return 1;
    if (first < 0xF0) return 2;
    return first < 0xF5 ? 3 : -1;
}

bool asterism_is_text(asterism_span text) {
    while (text.at != text.end) {
        uint8_t least, most;
        int more = more_bytes(*text.at++, &least, &most);
        if (more > text.end - text.at || more < 0) return false;
        for (; more > 0; more--, text.at++) {
            if (*text.at < least || *text.at > most) return false;
            least = 0x80;
            most = 0xBF;
        }
    }
    return true;
}

#ifdef ASTERISM_FLOAT
/* Rounded to the nearest, to even where two are as near; what is too small for a float is 0, too large infinite. */
static uint32_t float_bits(uint64_t bits) {
    const uint32_t sign = (uint32_t)(bits >> 63) << 31;
    const int exponent = (int)(bits >> 52 & 0x7FF) - 1023 + 127;
    const uint64_t fraction = bits & 0xFFFFFFFFFFFFFU;
    if ((bits >> 52 & 0x7FF) == 0x7FF) return sign | 0x7F800000U | (fraction ? 0x400000U : 0U);
    if (exponent >= 255) return sign | 0x7F800000U;
    if (exponent <= 0) return sign;
    const uint32_t kept = (uint32_t)exponent << 23 | (uint32_t)(fraction >> 29);
    const uint32_t left = (uint32_t)(fraction & 0x1FFFFFFFU);
    const bool up = left > 0x10000000U || (left == 0x10000000U && (kept & 1U));
    return sign | (kept + (up ? 1U : 0U));
}
#endif

asterism_real asterism_real_of(uint64_t bits) {
    asterism_real number;
#ifdef ASTERISM_FLOAT
    const uint32_t kept = float_bits(bits);
#else
    const uint64_t kept = bits;
#endif
    memcpy(&number, &kept, sizeof number);
    return number;
}

static bool is_digit(uint8_t character) { return character >= '0' && character <= '9'; }

bool asterism_whole_number(asterism_span text, uint64_t *number) {
    if (text.at == text.end || text.end - text.at > LONGEST_WHOLE) return false;
    *number = 0;
    for (; text.at != text.end; text.at++) {
        if (!is_digit(*text.at)) return false;
        const uint64_t digit = (uint64_t)(*text.at - '0');
        if (*number > UINT64_MAX / 10 || (*number == UINT64_MAX / 10 && digit > UINT64_MAX % 10)) return false;
        *number = 10 * *number + digit;
    }
    return true;
}

/* More digits than a number of ours can hold, in what a small processor multiplies by itself. */
#ifdef ASTERISM_FLOAT
typedef uint32_t mantissa;
#define FULL 100000000U
#else
typedef uint64_t mantissa;
#define FULL 100000000000000000U
#endif

/* Digits, the first 18 (with floats: 9) of which count: returns how many there were. */
static int digits(asterism_span *text, mantissa *number, int *power, bool after_point) {
    int count = 0;
    for (; text->at != text->end && is_digit(*text->at); text->at++, count++) {
        if (*number >= FULL) {
            *power += !after_point;
            continue;
        }
        *number = 10 * *number + (mantissa)(*text->at - '0');
        *power -= after_point;
    }
    return count;
}

static bool exponent(asterism_span *text, int *power) {
    mantissa size = 0;
    int left_out = 0;
    text->at++; /* the e */
    const bool below = text->at != text->end && *text->at == '-';
    if (text->at != text->end && (*text->at == '-' || *text->at == '+')) text->at++;
    if (digits(text, &size, &left_out, false) == 0) return false;
    const int most = size > 1000 ? 1000 : (int)size;
    *power += below ? -most : most;
    return true;
}

bool asterism_real_number(asterism_span text, asterism_real *number) {
    mantissa whole = 0;
    int power = 0;
    if (text.end - text.at > LONGEST_REAL) return false;
    int count = digits(&text, &whole, &power, false);
    if (text.at != text.end && *text.at == '.') {
        text.at++;
        count += digits(&text, &whole, &power, true);
    }
    if (count == 0) return false;
    if (text.at != text.end && (*text.at == 'e' || *text.at == 'E') && !exponent(&text, &power)) return false;
    if (text.at != text.end) return false;
    if (power < -LARGEST_POWER) whole = 0; /* nothing, for all that is told here */
    if (power > LARGEST_POWER && whole) return false;
    asterism_real scale = 1;
    for (int k = power < 0 ? -power : power; whole && k > 0; k--) scale *= 10;
    *number = power < 0 ? (asterism_real)whole / scale : (asterism_real)whole * scale;
    return true;
}
