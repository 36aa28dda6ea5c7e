"""Many films and recordings at once: on all cores, or on a cluster; what `asterism batch` does."""
