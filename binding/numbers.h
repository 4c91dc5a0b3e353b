/* Converts Python's numbers to numbers of the observer. */
#ifndef FLUXOBS_NUMBERS_H
#define FLUXOBS_NUMBERS_H

#include <cmath>
#include <limits>

extern "C" {
#include "fluxobs_real.h"
}

/* Beyond the range of single precision a number becomes infinite. The cast alone would be
 * undefined. */
inline fo_real real(double x) {
    constexpr double largest = std::numeric_limits<fo_real>::max();
    if (std::abs(x) > largest)
        return std::copysign(std::numeric_limits<fo_real>::infinity(), static_cast<fo_real>(x < 0 ? -1 : 1));
    return static_cast<fo_real>(x);
}

#endif
