/* Many records at once, one in each lane of the processor's vector units: the same numbers as
 * fo_step gives for each of them, bit for bit. For observers without a flux map. */
#ifndef FLUXOBS_LANES_H
#define FLUXOBS_LANES_H

extern "C" {
#include "fluxobs.h"
}

/* Records that run together: 8 in single precision, 4 in double. */
enum { LANES = 32 / sizeof(fo_real) };

/* Whether this compiler and this processor have them. */
bool lanes_here();

/* Rows of LANES records, from their states: [2] voltages and currents, `stride` numbers from a
 * record to the next; columns as write_plain writes them, `plane` numbers apart, a record's rows
 * together. */
void lanes_run(const fo_observer *observer, fo_state *states, const double *voltage,
               const double *current, size_t rows, double *columns, size_t plane, bool *valid);

#endif
