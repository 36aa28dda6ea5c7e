/* zenoh-c's own. */
#include "zenoh_both.h"

z_result_t zc_config_insert_json5(z_loaned_config_t *, const char *, const char *);
