/* Bytes of a prepared observer with its flux map, valid in this process only: an argument of the
 * calls in xla.cpp. */
#ifndef FLUXOBS_PARAMETERS_H
#define FLUXOBS_PARAMETERS_H

#include <cstddef>
#include <cstring>
#include <vector>

extern "C" {
#include "fluxobs_adaptive.h"
}

inline fo_observer &plain_of(fo_observer &observer) { return observer; }
inline fo_observer &plain_of(fo_adaptive &observer) { return observer.plain; }

/* The bytes are this struct, then the coefficients of the map's table. */
template <class Observer> class Parameters {
public:
    static std::vector<char> bytes(const Observer &observer, const fo_map *map) {
        Parameters parameters;
        parameters.size_ = sizeof parameters;
        std::memcpy(&parameters.observer_, &observer, sizeof observer);
        plain_of(parameters.observer_).map = nullptr;
        if (map) {
            parameters.has_map_ = true;
            parameters.map_ = *map;
            parameters.map_.coefficients = nullptr;
        }
        const std::size_t table = parameters.table_bytes();
        std::vector<char> raw(sizeof parameters + table);
        std::memcpy(raw.data(), static_cast<const void *>(&parameters), sizeof parameters);
        if (table > 0) std::memcpy(raw.data() + sizeof parameters, map->coefficients, table);
        return raw;
    }

    /* Reads the bytes, which must outlive this object. Returns false if the bytes are of another
     * kind. */
    bool load(const char *raw, std::size_t size) {
        std::memcpy(static_cast<void *>(this), raw, sizeof *this);
        if (size_ != sizeof *this || size < sizeof *this + table_bytes()) return false;
        if (has_map_) {
            const char *table = raw + sizeof *this;
            map_.coefficients = reinterpret_cast<const fo_real *>(table);
            plain_of(observer_).map = &map_;
        }
        return true;
    }

    const Observer *observer() const { return &observer_; }

private:
    std::size_t size_ = 0;
    bool has_map_ = false;
    Observer observer_{};
    fo_map map_{};

    std::size_t table_bytes() const {
        if (!has_map_ || map_.kind != FO_MAP_TABLE) return 0;
        return 2 * static_cast<std::size_t>(map_.nodes_d) * static_cast<std::size_t>(map_.nodes_q) *
               sizeof(fo_real);
    }
};

#endif
