/* fluxobs, the observers that these sources have: the plain one, and the adaptive one unless an export
 * leaves it out.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_OBSERVERS_H
#define FLUXOBS_OBSERVERS_H

#include "fluxobs.h"

#if FO_ADAPTIVE
#include "fluxobs_adaptive.h"
#endif

#endif
