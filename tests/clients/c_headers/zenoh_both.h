/* What robot_zenoh_c.c and robot_zenoh_pico.c use of both libraries, 1.x: declarations alone, so that a compiler can look
 * at the two without either being installed. Sizes are none of theirs.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef int8_t z_result_t;
#define Z_OK 0

#define OWNED(name)                                                        \
    typedef struct { void *kept; } z_owned_##name##_t;                     \
    typedef struct { z_owned_##name##_t kept; } z_moved_##name##_t;        \
    z_moved_##name##_t *z_##name##_move(z_owned_##name##_t *);             \
    void z_##name##_drop(z_moved_##name##_t *);
#define LOANED(name)                                                       \
    typedef struct z_loaned_##name##_t z_loaned_##name##_t;                \
    const z_loaned_##name##_t *z_##name##_loan(const z_owned_##name##_t *); \
    z_loaned_##name##_t *z_##name##_loan_mut(z_owned_##name##_t *);

OWNED(session) LOANED(session)
OWNED(config) LOANED(config)
OWNED(slice) LOANED(slice)
OWNED(closure_sample)
OWNED(closure_reply)
typedef struct z_loaned_bytes_t z_loaned_bytes_t;
typedef struct z_loaned_keyexpr_t z_loaned_keyexpr_t;
typedef struct z_loaned_reply_t z_loaned_reply_t;
typedef struct z_loaned_sample_t z_loaned_sample_t;
typedef struct { void *kept; } z_view_keyexpr_t;
typedef struct { void *kept; } z_bytes_reader_t;
typedef struct z_get_options_t z_get_options_t;
typedef struct z_open_options_t z_open_options_t;
typedef struct z_subscriber_options_t z_subscriber_options_t;

z_result_t z_config_default(z_owned_config_t *);
z_result_t z_open(z_owned_session_t *, z_moved_config_t *, const z_open_options_t *);
z_result_t z_view_keyexpr_from_str(z_view_keyexpr_t *, const char *);
const z_loaned_keyexpr_t *z_view_keyexpr_loan(const z_view_keyexpr_t *);
void z_closure_sample(z_owned_closure_sample_t *, void (*)(z_loaned_sample_t *, void *), void (*)(void *), void *);
void z_closure_reply(z_owned_closure_reply_t *, void (*)(z_loaned_reply_t *, void *), void (*)(void *), void *);
z_result_t z_declare_background_subscriber(const z_loaned_session_t *, const z_loaned_keyexpr_t *,
                                           z_moved_closure_sample_t *, z_subscriber_options_t *);
z_result_t z_get(const z_loaned_session_t *, const z_loaned_keyexpr_t *, const char *, z_moved_closure_reply_t *,
                 z_get_options_t *);
bool z_reply_is_ok(const z_loaned_reply_t *);
const z_loaned_sample_t *z_reply_ok(const z_loaned_reply_t *);
const z_loaned_bytes_t *z_sample_payload(const z_loaned_sample_t *);
size_t z_bytes_len(const z_loaned_bytes_t *);
z_bytes_reader_t z_bytes_get_reader(const z_loaned_bytes_t *);
size_t z_bytes_reader_read(z_bytes_reader_t *, uint8_t *, size_t);
z_result_t z_bytes_to_slice(const z_loaned_bytes_t *, z_owned_slice_t *);
const uint8_t *z_slice_data(const z_loaned_slice_t *);
size_t z_slice_len(const z_loaned_slice_t *);
