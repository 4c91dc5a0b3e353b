/* The likelihood without derivatives; see values.h. */
#define FO_VALUES_ONLY
#include "innovations.c"
