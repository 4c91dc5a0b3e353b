/* Cells of operating point and angle: the model's error is constant within each, and unknown.
 *
 * Marginalised, the errors change the information of the blocks from the diagonal W = 1/spread to
 * W - W B K B' W, with the cells' members B and K = (1/σ² + B' W B)⁻¹ (Woodbury). */
#ifndef FLUXOBS_CELLS_H
#define FLUXOBS_CELLS_H

#include "rows.h"

typedef struct {
    size_t count;
    int32_t *of; /* per block; -1 without measurement */
} fo_cells;

/* `spread`: blocks * measurements. False: no memory. */
bool fo_find_cells(const fo_work *w, const double *spread, double usual_speed, fo_cells *cells);
void fo_free_cells(fo_cells *cells);

#endif
