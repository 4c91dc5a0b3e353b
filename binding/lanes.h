/* Processes many records at once, each in one lane of the processor's vector units. The numbers are
 * bit for bit those of fo_step. For observers without a flux map. */
#ifndef FLUXOBS_LANES_H
#define FLUXOBS_LANES_H

extern "C" {
#include "fluxobs.h"
}

/* Records that run together: 8 in single precision, 4 in double. */
enum { LANES = 32 / sizeof(fo_real) };

/* Whether this compiler and this processor have vector units for lanes. */
bool lanes_here();

/* Processes rows of LANES records, from their states. Voltages and currents are [2], `stride`
 * numbers from one record to the next. Columns are those of write_plain, `plane` numbers apart; the
 * rows of a record are contiguous. */
void lanes_run(const fo_observer *observer, fo_state *states, const double *voltage,
               const double *current, size_t rows, double *columns, size_t plane, bool *valid);

#endif
