// Python interface of the estimate of a log, for arrays; Python checks shapes and values.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>
#include <stdexcept>
#include <utility>

#include "owned.h"

extern "C" {
#include "arrays.h"
}

namespace nb = nanobind;

namespace {

using Column = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Numbers = std::unique_ptr<double[]>;

nb::tuple estimate(const Column &file, int kind, bool magnets, const Column &map, const Table &coefficients,
                   const Rows &voltage, const Rows &current, double sample_time, const Column &hints, bool sure,
                   const Column &start, std::size_t stride) {
    const std::size_t rows = voltage.shape(0), sampled = (rows + stride - 1) / stride;
    const fo_log_arrays in = {file.data(),
                              kind,
                              magnets ? 1 : 0,
                              map.data(),
                              coefficients.data(),
                              static_cast<int>(coefficients.shape(0)),
                              static_cast<int>(coefficients.shape(1)),
                              rows,
                              sample_time,
                              voltage.data(),
                              current.data(),
                              hints.data(),
                              sure ? 1 : 0,
                              stride};
    const fo_sizes &n = fo_log_sizes;
    Numbers parameters(new double[n.unknowns]), covariance(new double[n.unknowns * n.unknowns]),
        about(new double[n.log]), columns(new double[rows * n.row]()),
        shares(new double[sampled * n.quantities * n.shares]());
    std::copy_n(start.data(), n.unknowns, parameters.get());
    int outcome = 0;
    {
        nb::gil_scoped_release released;
        outcome = fo_estimate_arrays_of_log(&in, parameters.get(), covariance.get(), about.get(), columns.get(),
                                            shares.get());
    }
    if (fo_interrupted) throw std::runtime_error("stopped");
    if (outcome < 0) throw std::bad_alloc();
    return nb::make_tuple(outcome > 0, owned(std::move(parameters), {n.unknowns}),
                          owned(std::move(covariance), {n.unknowns, n.unknowns}), owned(std::move(about), {n.log}),
                          owned(std::move(columns), {rows, n.row}),
                          owned(std::move(shares), {sampled, n.quantities, n.shares}));
}

}  // namespace

NB_MODULE(_engine, m) {
    m.def("estimate", &estimate, nb::arg("file"), nb::arg("kind"), nb::arg("magnets"), nb::arg("map"),
          nb::arg("coefficients"), nb::arg("voltage"), nb::arg("current"), nb::arg("sample_time"), nb::arg("hints"),
          nb::arg("sure"), nb::arg("start"), nb::arg("stride"));
    m.def("stop", [] { fo_interrupted = 1; });
    m.attr("parameters") = nb::str(fo_parameter_names);
    m.attr("levels") = fo_log_sizes.levels;
    m.attr("file_fields") = nb::str(fo_file_names);
    m.attr("map_fields") = nb::str(fo_map_fields);
    m.attr("row_numbers") = nb::str(fo_row_names);
    m.attr("log_numbers") = nb::str(fo_log_names);
    m.attr("orders") = nb::str(fo_orders);
}
