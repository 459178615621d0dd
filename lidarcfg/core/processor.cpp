/// A module that runs on every processor, to be asked before one of the core's is loaded.
#include "processor.h"

#include <nanobind/nanobind.h>

NB_MODULE(_core_processor, module) {
  module.def("x86_64_level", &lidarcfg::x86_64_level, "The x86-64 level of this processor, from 1 to 3; 0: none.");
}
