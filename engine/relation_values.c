/* The relation without derivatives; see values.h. */
#define FO_VALUES_ONLY
#include "relation.c"
