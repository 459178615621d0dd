#include "vsr/grid.h"

#include <stdexcept>
#include <vector>

namespace lidarcfg::vsr {
namespace {

void require(bool holds, const char* message) {
  if (!holds) {
    throw std::invalid_argument(message);
  }
}

}  // namespace

struct Grid::Arrays {
  std::vector<double> x, y, z, weight;
  std::vector<Word> included, weighted;
  std::vector<Links> links;
};

Grid::Grid(View<const double> x, View<const double> y, View<const double> z, View<const Word> included,
           const Vec3& edge, View<const double> weight, Rows<const Word> weighted)
    : edge(edge), nx_(std::ssize(x)) {
  require(!x.empty(), "x: empty");
  require(!y.empty(), "y: empty");
  require(!z.empty(), "z: empty");
  const Index chunks = (nx_ + row_size - 1) / row_size;
  const Index layer = chunks * (std::ssize(y) + 2);
  require(std::ssize(included) == layer * (std::ssize(z) + 2), "included: one word for each row, with the margin");
  require(weighted.rows() == std::ssize(weight), "weighted: one row for each weight");
  require(weighted.rows() == 0 || weighted.columns() == std::ssize(included), "weighted: as long as included");

  auto arrays = std::make_shared<Arrays>();
  arrays->x.assign(x.begin(), x.end());
  arrays->x.resize(chunks * row_size, x.back());
  arrays->y.assign(y.begin(), y.end());
  arrays->z.assign(z.begin(), z.end());
  arrays->weight.assign(weight.begin(), weight.end());
  arrays->included.assign(included.begin(), included.end());
  arrays->weighted.assign(weighted.data(), weighted.data() + weighted.size());
  arrays->links.resize(included.size());

  const Word beyond_last = nx_ % row_size ? ~(bit(nx_ % row_size) - 1) : 0;
  for (Index row = 0; row < std::ssize(included); ++row) {
    const Word word = included[row];
    const Index j = row % layer / chunks;
    const bool margin = row < layer || row >= std::ssize(included) - layer || j == 0 || j == std::ssize(y) + 1;
    const bool last = row % chunks == chunks - 1;
    require(!(word & (margin ? all_bits : last ? beyond_last : 0)), "included: no cuboid of the margin");
    if (word) {
      const Word before = row % chunks ? included[row - 1] >> (row_size - 1) : 0;
      arrays->links[row] = {word & (word << 1 | before), word & included[row - chunks], word & included[row - layer]};
    }
  }
  this->x = arrays->x;
  this->y = arrays->y;
  this->z = arrays->z;
  this->included = arrays->included;
  this->links = arrays->links;
  this->weight = arrays->weight;
  this->weighted = {arrays->weighted.data(), weighted.rows(), weighted.rows() ? weighted.columns() : 0};
  arrays_ = std::move(arrays);
}

}  // namespace lidarcfg::vsr
