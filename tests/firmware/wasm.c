/* The exported check as a WebAssembly function: returns 0 if every output equals that of the
 * library. */
#include "check.h"

__attribute__((export_name("check"))) int check(void)
{
    check_result r;
    check_replay(&r);
    return r.damaged || r.wrong > 0 || r.between || r.valid == 0 ? 1 + r.wrong : 0;
}
