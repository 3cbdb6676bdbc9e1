// Corners of a dark square from lines fitted to its sides: finer than a pixel, with the covariance that the scatter of
// the edge points about their lines tells. And what is printed in it.

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "visp_binding.h"

#include <pybind11/stl.h>

namespace py = pybind11;

namespace {

using Point = std::array<double, 2>;

// Rows of grey levels, one after the other.
struct Image {
  const unsigned char *pixels;
  py::ssize_t width, height;
};

// Of a side, left out at each end, where the neighbouring side bends the edge.
constexpr double margin = 0.1;
constexpr int min_sites = 6, max_sites = 48;
// Sum of the gradient across an edge, in grey levels, that tells it from noise (chosen).
constexpr double min_contrast = 12;
// Sites farther than this from their line, in standard deviations, are of something else (chosen); and what that leaves
// of the variance of sites that are all of the line.
constexpr double outlier = 2.5, kept = 0.89;
// A side whose change from black to white is hardly wider than interpolation makes it, as a variance in px², was drawn
// without mixed pixels: either end of it is known to a pixel only. Cameras mix (0.35 and more of tags drawn as a camera
// sees them), renderers need not (0.17 at most). By how much a pixel is off is measured on the simulator's pictures.
constexpr double sharp = 0.18, soft = 0.30, pixel_variance = 0.18;
// White that the sensor clips has its edge moved outwards, by how much depends on how bright it was (chosen).
constexpr double clipped_grey = 254.5, clipped_variance = 0.05 * 0.05;

bool inside(const Image &image, double u, double v) {
  return u >= 0 && v >= 0 && u < static_cast<double>(image.width - 1) && v < static_cast<double>(image.height - 1);
}

double at(const Image &image, double u, double v) {
  const int c = static_cast<int>(u), r = static_cast<int>(v);
  const double fu = u - c, fv = v - r;
  const unsigned char *const above = image.pixels + r * image.width + c, *const below = above + image.width;
  const double upper = above[0] + fu * (above[1] - above[0]), lower = below[0] + fu * (below[1] - below[0]);
  return upper + fv * (lower - upper);
}

// A side: from its origin along a direction, and its offset a + b s to the outside at s px, with their covariance.
struct Side {
  Point origin, along;
  double length, a = 0, b = 0;
  double var_a = 0, cov_ab = 0, var_b = 0;

  Side(const Point &from, const Point &to) : origin(from) {
    along = {to[0] - from[0], to[1] - from[1]};
    length = std::hypot(along[0], along[1]);
    along = {along[0] / length, along[1] / length};
  }
  Point outside() const { return {-along[1], along[0]}; }
  Point at(double s, double t) const {
    const Point n = outside();
    return {origin[0] + s * along[0] + t * n[0], origin[1] + s * along[1] + t * n[1]};
  }
};

// Moves the side to the edge within reach of it; false where there is none. While it is sought, other edges may be within
// reach: those that fall are left out. Leaving out what falls by noise alone would draw each site towards the line.
bool fit(const Image &image, Side &side, double reach, bool seeking) {
  const double span = (1 - 2 * margin) * side.length;
  const int n = std::clamp(static_cast<int>(span), min_sites, max_sites);
  constexpr double step = 0.5;
  const int half = std::max(2, static_cast<int>(std::lround(reach / step)));
  double width = 0, clipped = 0, ends = 0, total = 0;
  std::vector<double> s, t, profile(static_cast<std::size_t>(2 * half + 3));
  for (int k = 0; k < n; ++k) {
    const double along = margin * side.length + span * (k + 0.5) / n, middle = side.a + side.b * along;
    const Point first = side.at(along, middle - (half + 1) * step), last = side.at(along, middle + (half + 1) * step);
    if (!inside(image, first[0], first[1]) || !inside(image, last[0], last[1])) continue;
    const double du = step * side.outside()[0], dv = step * side.outside()[1];
    for (int i = 0; i < 2 * half + 3; ++i)
      profile[static_cast<std::size_t>(i)] = at(image, first[0] + i * du, first[1] + i * dv);
    double sum = 0, moment = 0, second = 0;
    for (int i = 0; i <= 2 * half; ++i) {
      // White lies outside.
      const double slope = profile[static_cast<std::size_t>(i + 2)] - profile[static_cast<std::size_t>(i)];
      const double weight = seeking ? std::max(0.0, slope) : slope;
      sum += weight;
      moment += weight * (i - half) * step;
      second += weight * (i - half) * step * (i - half) * step;
    }
    if (sum * step < min_contrast) continue;
    ends += profile[2] - profile[0] + profile[static_cast<std::size_t>(2 * half + 2)] - profile[static_cast<std::size_t>(2 * half)];
    total += sum;
    s.push_back(along);
    t.push_back(middle + moment / sum);
    if (*std::max_element(profile.begin(), profile.end()) > clipped_grey) ++clipped;
    width += second / sum - moment * moment / (sum * sum);
  }
  // Where the window cuts off a part of a blurred edge, sites follow the window's middle, which is the line of the fit
  // before: so much less than the line is off do they scatter about it.
  const double follow = total > 0 ? (half + 0.5) * std::max(0.0, ends) / total : 0;
  const double gain = std::max(1 - follow, 0.2);
  std::vector<char> good(s.size(), 1);
  double variance = 0;
  for (int pass = 0; pass < 3; ++pass) {
    double m = 0, ms = 0, mt = 0, ss = 0, st = 0;
    for (std::size_t i = 0; i < s.size(); ++i)
      if (good[i]) m += 1, ms += s[i], mt += t[i];
    if (m < std::max<double>(min_sites - 1, 0.5 * n)) return false;
    ms /= m, mt /= m;
    for (std::size_t i = 0; i < s.size(); ++i)
      if (good[i]) ss += (s[i] - ms) * (s[i] - ms), st += (s[i] - ms) * (t[i] - mt);
    side.b = st / ss;
    side.a = mt - side.b * ms;
    double rr = 0;
    for (std::size_t i = 0; i < s.size(); ++i)
      if (good[i]) rr += std::pow(t[i] - side.a - side.b * s[i], 2);
    variance = rr / (m - 2);
    const double own = variance / (kept * gain * gain);
    side.var_b = own / ss;
    side.cov_ab = -ms * side.var_b;
    side.var_a = own / m + ms * ms * side.var_b;
    // Of either end of the side.
    const double found = static_cast<double>(s.size());
    const double common = pixel_variance * std::clamp((soft - width / found) / (soft - sharp), 0.0, 1.0) +
                          clipped_variance * clipped / found;
    side.var_a += common;
    side.cov_ab -= common / side.length;
    side.var_b += 2 * common / (side.length * side.length);
    if (pass == 2) break;
    const double limit = std::max(outlier * std::sqrt(variance), 0.05);
    for (std::size_t i = 0; i < s.size(); ++i) good[i] = std::fabs(t[i] - side.a - side.b * s[i]) <= limit;
  }
  return true;
}

using Corners = py::array_t<double, py::array::c_style | py::array::forcecast>;

std::array<Point, 4> four_points(const Corners &corners) {
  if (corners.ndim() != 2 || corners.shape(0) != 4 || corners.shape(1) != 2)
    throw InvalidInput("corners have shape " + std::string(py::str(py::object(corners.attr("shape")))) +
                       ", expected (4, 2)");
  std::array<Point, 4> out{};
  for (py::ssize_t i = 0; i < 4; ++i)
    for (py::ssize_t j = 0; j < 2; ++j) {
      out[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)] = corners.at(i, j);
      if (!std::isfinite(corners.at(i, j))) throw InvalidInput("corners hold a number that is not finite");
    }
  return out;
}

Image image_of(const py::array &image) {
  check_image(image);
  return {static_cast<const unsigned char *>(image.data()), image.shape(1), image.shape(0)};
}

std::optional<std::pair<py::array_t<double>, py::array_t<double>>> fit_square(
    const py::array &image, const Corners &corners, double reach, double final_reach) {
  const Image pixels = image_of(image);
  const std::array<Point, 4> start = four_points(corners);
  if (!(reach > 0 && final_reach > 0)) throw InvalidInput("reach is not more than 0");
  std::vector<Side> sides;
  {
    py::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < 4; ++i) {
      sides.emplace_back(start[i], start[(i + 1) % 4]);
      Side &side = sides.back();
      if (!(side.length >= min_sites)) return std::nullopt;
      if (!fit(pixels, side, reach, true)) return std::nullopt;
      for (int again = 0; again < 3; ++again)
        if (!fit(pixels, side, final_reach, false)) return std::nullopt;
    }
  }
  // Corner i is where side i - 1 ends and side i begins; its covariance follows from the offsets of both there.
  py::array_t<double> found({4, 2}), covariance({8, 8});
  auto uv = found.mutable_unchecked<2>();
  auto C = covariance.mutable_unchecked<2>();
  std::array<std::array<double, 8>, 8> J{};  // d(corners) / d(a, b of each side)
  for (std::size_t i = 0; i < 4; ++i) {
    const std::size_t p = (i + 3) % 4;
    const std::array<const Side *, 2> two = {&sides[p], &sides[i]};
    std::array<Point, 2> normal{};
    std::array<double, 2> distance{};
    for (std::size_t k = 0; k < 2; ++k) {
      const Side &side = *two[k];
      const Point n = side.outside();
      normal[k] = {n[0] - side.b * side.along[0], n[1] - side.b * side.along[1]};
      distance[k] = side.a + normal[k][0] * side.origin[0] + normal[k][1] * side.origin[1];
    }
    const double det = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
    if (std::fabs(det) < 0.05) return std::nullopt;
    const double u = (distance[0] * normal[1][1] - distance[1] * normal[0][1]) / det;
    const double v = (normal[0][0] * distance[1] - normal[1][0] * distance[0]) / det;
    const auto row = static_cast<py::ssize_t>(i);
    uv(row, 0) = u;
    uv(row, 1) = v;
    for (std::size_t k = 0; k < 2; ++k) {
      const Side &side = *two[k];
      const double s = (u - side.origin[0]) * side.along[0] + (v - side.origin[1]) * side.along[1];
      const double du = (k == 0 ? normal[1][1] : -normal[0][1]) / det, dv = (k == 0 ? -normal[1][0] : normal[0][0]) / det;
      const std::size_t column = 2 * (k == 0 ? p : i);
      J[2 * i][column] = du, J[2 * i + 1][column] = dv;
      J[2 * i][column + 1] = du * s, J[2 * i + 1][column + 1] = dv * s;
    }
  }
  for (std::size_t r = 0; r < 8; ++r)
    for (std::size_t c = 0; c < 8; ++c) {
      double sum = 0;
      for (std::size_t k = 0; k < 4; ++k) {
        const Side &side = sides[k];
        sum += J[r][2 * k] * (side.var_a * J[c][2 * k] + side.cov_ab * J[c][2 * k + 1]) +
               J[r][2 * k + 1] * (side.cov_ab * J[c][2 * k] + side.var_b * J[c][2 * k + 1]);
      }
      C(static_cast<py::ssize_t>(r), static_cast<py::ssize_t>(c)) = sum;
    }
  return std::make_pair(std::move(found), std::move(covariance));
}

// The grey in the middle of each of cells x cells of a square, row by row from the top, less their mean and as a vector
// of length 1: of two patterns the dot product is the correlation. Zeros where the square is even.
py::array_t<double> pattern(const py::array &image, const Corners &corners, int cells) {
  const Image pixels = image_of(image);
  // The projective map from the unit square, u right and v down.
  const auto [p01, p11, p10, p00] = four_points(corners);
  const Point one = {p10[0] - p11[0], p10[1] - p11[1]}, two = {p01[0] - p11[0], p01[1] - p11[1]};
  const Point sum = {p00[0] - p10[0] + p11[0] - p01[0], p00[1] - p10[1] + p11[1] - p01[1]};
  const double det = one[0] * two[1] - two[0] * one[1];
  const double g = (sum[0] * two[1] - two[0] * sum[1]) / det, h = (one[0] * sum[1] - sum[0] * one[1]) / det;
  if (cells < 1) throw InvalidInput("cells is " + std::to_string(cells) + ", expected at least 1");
  std::vector<double> grey;
  double mean = 0, power = 0;
  for (int row = 0; row < cells; ++row)
    for (int column = 0; column < cells; ++column) {
      const double u = (column + 0.5) / cells, v = (row + 0.5) / cells, w = 1 + g * u + h * v;
      Point p{};
      for (std::size_t k = 0; k < 2; ++k)
        p[k] = (p00[k] + (p10[k] - p00[k] + g * p10[k]) * u + (p01[k] - p00[k] + h * p01[k]) * v) / w;
      grey.push_back(inside(pixels, p[0], p[1]) ? at(pixels, p[0], p[1]) : 0);
      mean += grey.back() / (cells * cells);
    }
  for (double &value : grey) {
    value -= mean;
    power += value * value;
  }
  py::array_t<double> out(static_cast<py::ssize_t>(grey.size()));
  std::transform(grey.begin(), grey.end(), out.mutable_data(),
                 [scale = power > 0 ? 1 / std::sqrt(power) : 0](double value) { return scale * value; });
  return out;
}

}  // namespace

void bind_edge_fit(py::module_ &m) {
  m.def("fit_square", &fit_square, py::arg("image"), py::arg("corners"), py::arg("reach"), py::arg("final_reach"),
        "Corners (4, 2) px, and their covariance (8, 8) px², of a dark square on a bright ground whose corners (4, 2) are\n"
        "known to within `reach` px; None where one of its sides is not to be seen. The image is grey, without distortion;\n"
        "pixel centres have integer coordinates.");
  m.def("pattern", &pattern, py::arg("image"), py::arg("corners"), py::arg("cells"),
        "What is printed in a square with corners (4, 2) px: grey levels (cells * cells,) in the middle of its cells, less\n"
        "their mean and scaled to length 1 (0 where it is even), so that the dot product of two is their correlation.");
}
