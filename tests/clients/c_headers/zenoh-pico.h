/* zenoh-pico's own. */
#include "zenoh_both.h"

#define Z_CONFIG_MODE_KEY 0x40
#define Z_CONFIG_MODE_CLIENT "client"
#define Z_CONFIG_CONNECT_KEY 0x41
#define Z_CONFIG_MULTICAST_SCOUTING_KEY 0x45
z_result_t zp_config_insert(z_loaned_config_t *, uint8_t, const char *);

#if Z_FEATURE_MULTI_THREAD == 1
OWNED(mutex) LOANED(mutex)
z_result_t z_mutex_init(z_owned_mutex_t *);
z_result_t z_mutex_lock(z_loaned_mutex_t *);
z_result_t z_mutex_unlock(z_loaned_mutex_t *);
#else
bool zp_spin_once(const z_loaned_session_t *);
#endif

typedef struct { void *kept; } z_clock_t;
z_clock_t z_clock_now(void);
unsigned long z_clock_elapsed_us(z_clock_t *);
void z_clock_advance_us(z_clock_t *, unsigned long);
z_result_t z_sleep_ms(size_t);
z_result_t z_sleep_s(size_t);
