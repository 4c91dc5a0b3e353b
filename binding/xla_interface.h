/* Part of XLA's interface for custom calls that xla.cpp uses. The declarations are from
 * xla/ffi/api/c_api.h of jaxlib 0.10 (version 0.3 of the interface); they are the same in version
 * 0.1, jaxlib 0.5. XLA only appends fields, and every struct states its size.
 * tests/simulation/drive/test_loop_observer.py compares these declarations with the header of the
 * installed jaxlib. */
#ifndef FLUXOBS_XLA_INTERFACE_H
#define FLUXOBS_XLA_INTERFACE_H

#include <cstddef>
#include <cstdint>

namespace xla {

enum { METADATA = 1, INVALID_ARGUMENT = 3, U8 = 6, F64 = 12, VERSION_MAJOR = 0, VERSION_MINOR = 3 };

struct Extension {
    size_t struct_size;
    int type; /* METADATA */
    Extension *next;
};

struct Version {
    size_t struct_size;
    Extension *extension_start;
    int major_version, minor_version;
};

struct Metadata {
    size_t struct_size;
    Version api_version;
    uint32_t traits;
};

struct MetadataExtension {
    Extension extension_base;
    Metadata *metadata;
};

struct ErrorArguments {
    size_t struct_size;
    Extension *extension_start;
    const char *message;
    int errc;
};

struct Api {
    size_t struct_size;
    Extension *extension_start;
    Version api_version;
    const void *internal_api;
    void *(*error_create)(ErrorArguments *);
};

struct Buffer {
    size_t struct_size;
    Extension *extension_start;
    int dtype;
    void *data;
    int64_t rank;
    int64_t *dims;
};

struct Buffers { /* XLA_FFI_Args and XLA_FFI_Rets */
    size_t struct_size;
    Extension *extension_start;
    int64_t size;
    int *types;
    void **items;
};

struct CallFrame {
    size_t struct_size;
    Extension *extension_start;
    const Api *api;
    void *ctx;
    int stage;
    Buffers args, rets;
};

}  // namespace xla

#endif
