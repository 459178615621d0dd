#include "vsr/components.h"

#include <algorithm>

#include "vsr/flood.h"

namespace lidarcfg::vsr {
namespace {

constexpr Index scan_interval = 4;  // layers along x, after which it is looked anew where something is left

}  // namespace

Components label_components(const Grid& grid, View<const Links> links, Tables<std::int32_t> label) {
  const auto [nx, ny, nz] = grid.shape();
  const Index step_y = grid.step_y();
  const Index step_z = grid.step_z();
  std::fill_n(label.data(), label.size(), -1);
  Components out;
  Flooder flooder(grid);
  const std::vector<Word>& left = flooder.left();
  std::vector<Word> some(ny);  // which of 64 layers along x have something left, by row along y: not all are read
  for (Index i = 0; i < nx; ++i) {
    const Index chunk = i / row_size;
    const Word layer = bit(i % row_size);
    if (i % scan_interval == 0) {
      std::ranges::fill(some, 0);
      for (Index k = 0; k < nz; ++k) {
        for (Index j = 0; j < ny; ++j) {
          some[j] |= left[(k + 1) * step_z + (j + 1) * step_y + chunk];
        }
      }
    }
    for (Index j = 0; j < ny; ++j) {
      for (Index k = 0; k < (some[j] & layer ? nz : 0); ++k) {
        const Index row = (k + 1) * step_z + (j + 1) * step_y + chunk;
        if (!(left[row] & layer)) {
          continue;
        }
        const Subspace& found = flooder.flood(links, row * row_size + i % row_size);
        const auto number = static_cast<std::int32_t>(out.first.size());
        for (auto [at, bits] : flooder.steps()) {
          const Index x = at % step_y * row_size;
          const Index y = at % step_z / step_y - 1;
          const Index z = at / step_z - 1;
          for (; bits; bits &= bits - 1) {
            label(x + lowest(bits), y, z) = number;
          }
        }
        out.first.push_back((i * ny + j) * nz + k);
        out.cuboids.push_back(found.cuboids);
        out.internal.insert(out.internal.end(), found.internal.begin(), found.internal.end());
      }
    }
  }
  return out;
}

}  // namespace lidarcfg::vsr
