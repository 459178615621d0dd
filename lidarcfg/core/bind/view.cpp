#include "bind/arguments.h"
#include "bind/modules.h"
#include "view/raster.h"

namespace lidarcfg::bind {

void bind_view(nb::module_& module) {
  def(
      module, "blend_triangles",
      [](Tables<float> image, Rows<const float> depth_m, Rows<const Vec3> triangles, View<const Vec3> colours,
         View<const double> alpha, double focal_px, double near_m) {
        require(image.tables() == depth_m.rows() && image.rows() == depth_m.columns(), "image: of another size");
        require(image.columns() == 3, "image: three colours a pixel");
        require(triangles.columns() == 3, "triangles: three corners each");
        require(std::ssize(colours) == triangles.rows(), "colours: one for each triangle");
        require(std::ssize(alpha) == triangles.rows(), "alpha: one for each triangle");
        return view::blend_triangles(image, depth_m, triangles, colours, alpha, focal_px, near_m);
      },
      "Blend triangles into an image where they are nearer than a depth.", "image", "depth_m", "triangles", "colours",
      "alpha", "focal_px", "near_m");
}

}  // namespace lidarcfg::bind
