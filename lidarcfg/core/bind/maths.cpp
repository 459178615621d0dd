#include "maths.h"

#include "bind/arguments.h"
#include "bind/modules.h"

namespace lidarcfg::bind {
namespace {

using Function = double (*)(double);

void add(nb::module_& module, const char* name, Function function, const char* doc) {
  def(
      module, name,
      [function](View<const double> x, View<double> out) {
        require(x.size() == out.size(), "out: one for each x");
        for (std::size_t n = 0; n < x.size(); ++n) {
          out[n] = function(x[n]);
        }
      },
      doc, "x", "out");
}

}  // namespace

void bind_maths(nb::module_& module) {
  add(module, "sin", &lidarcfg::sin, "Write the sines of angles in radians.");
  add(module, "cos", &lidarcfg::cos, "Write the cosines of angles in radians.");
  add(module, "tan", &lidarcfg::tan, "Write the tangents of angles in radians.");
  add(module, "asin", &lidarcfg::asin, "Write the angles in radians whose sines are given.");
  add(module, "acos", &lidarcfg::acos, "Write the angles in radians whose cosines are given.");
  add(module, "exp", &lidarcfg::exp, "Write e to the power of each value.");
  add(module, "log", &lidarcfg::log, "Write the natural logarithms.");
  def(
      module, "atan2",
      [](View<const double> y, View<const double> x, View<double> out) {
        require(x.size() == y.size(), "x: one for each y");
        require(out.size() == y.size(), "out: one for each y");
        for (std::size_t n = 0; n < y.size(); ++n) {
          out[n] = lidarcfg::atan2(y[n], x[n]);
        }
      },
      "Write the angles in radians of points (x, y).", "y", "x", "out");
}

}  // namespace lidarcfg::bind
