// Python interface of the smoother, for arrays; Python checks shapes and values.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <memory>

#include "smoother.h"

namespace nb = nanobind;

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<nb::numpy, double>;

constexpr std::size_t N = FO_SMOOTH;
static_assert(sizeof(fo_smooth_block) == (9 + N) * sizeof(double), "a block is a row of numbers");

struct Room {
    explicit Room(std::size_t count) : numbers(new double[count]) {}
    double *get() const { return numbers.get(); }
    Result owned(std::initializer_list<std::size_t> shape) {
        nb::capsule owner(numbers.get(),
                          [](void *p) noexcept { delete[] static_cast<double *>(p); });
        return Result(numbers.release(), shape, owner);
    }
    std::unique_ptr<double[]> numbers;
};

nb::tuple smooth(const Rows &blocks, const Rows &measured, const Column &start) {
    const std::size_t count = blocks.shape(0), sides = measured.shape(1);
    Room state(count * N * sides), covariance(count * N * N), innovation(count * sides),
        spread(count), gain(count * N), work(2 * N * sides);
    const fo_smooth_room room = {state.get(),  covariance.get(), innovation.get(),
                                 spread.get(), gain.get(),       work.get()};
    {
        nb::gil_scoped_release released;
        fo_smooth(reinterpret_cast<const fo_smooth_block *>(blocks.data()), count, measured.data(),
                  sides, start.data(), &room);
    }
    return nb::make_tuple(state.owned({count, N, sides}), covariance.owned({count, N, N}),
                          innovation.owned({count, sides}), spread.owned({count}));
}

}  // namespace

NB_MODULE(_smoother, m) {
    m.def("smooth", &smooth, nb::arg("blocks"), nb::arg("measured"), nb::arg("start"));
    m.attr("states") = static_cast<int>(FO_SMOOTH);
}
