// Python interface of the smoother, for arrays; Python checks shapes and values.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <memory>
#include <utility>

#include "owned.h"
#include "smoother.h"

namespace nb = nanobind;

namespace {

using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

constexpr std::size_t N = FO_SMOOTH;
static_assert(sizeof(fo_smooth_block) == (9 + N) * sizeof(double), "a block is a row of numbers");

using Numbers = std::unique_ptr<double[]>;

Numbers room_for(std::size_t count) { return Numbers(new double[count]); }

nb::tuple smooth(const Rows &blocks, const Rows &measured, const Column &start) {
    const std::size_t count = blocks.shape(0), sides = measured.shape(1);
    Numbers state = room_for(count * N * sides), covariance = room_for(count * N * N),
            innovation = room_for(count * sides), spread = room_for(count),
            gain = room_for(count * N), work = room_for(2 * N * sides);
    const fo_smooth_room room = {state.get(),  covariance.get(), innovation.get(),
                                 spread.get(), gain.get(),       work.get()};
    {
        nb::gil_scoped_release released;
        fo_smooth(reinterpret_cast<const fo_smooth_block *>(blocks.data()), count, measured.data(),
                  sides, start.data(), &room);
    }
    return nb::make_tuple(
        owned(std::move(state), {count, N, sides}), owned(std::move(covariance), {count, N, N}),
        owned(std::move(innovation), {count, sides}), owned(std::move(spread), {count}));
}

}  // namespace

NB_MODULE(_smoother, m) {
    m.def("smooth", &smooth, nb::arg("blocks"), nb::arg("measured"), nb::arg("start"));
    m.attr("states") = static_cast<int>(FO_SMOOTH);
}
