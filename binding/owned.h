// Arrays for Python that own their numbers.
#ifndef FLUXOBS_OWNED_H
#define FLUXOBS_OWNED_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <memory>

template <class T>
nanobind::ndarray<nanobind::numpy, T> owned(std::unique_ptr<T[]> data,
                                            std::initializer_list<std::size_t> shape) {
    nanobind::capsule owner(data.get(), [](void *p) noexcept { delete[] static_cast<T *>(p); });
    return nanobind::ndarray<nanobind::numpy, T>(data.release(), shape, owner);
}

#endif
