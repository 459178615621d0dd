#include "bind/arguments.h"
#include "bind/modules.h"

namespace lidarcfg::bind {

void bind_analytic(nb::module_& module) { (void)module; }

}  // namespace lidarcfg::bind
