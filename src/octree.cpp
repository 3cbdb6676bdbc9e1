// OctoMap's octree, and a reader of its .bt files that trusts nothing; use both through hitchhike_ros.mapping.octree.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <octomap/octomap.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

namespace py = pybind11;

namespace {

using Points = py::array_t<double, py::array::c_style>;

constexpr int kDepth = 16;  // of every OctoMap: keys have 16 bits

void insert(octomap::OcTree &tree, const Points &points, const Points &origin, double max_range_m) {
  if (points.ndim() != 2 || points.shape(1) != 3 || origin.ndim() != 1 || origin.shape(0) != 3)
    throw std::invalid_argument("points and origin must be (N, 3) and (3,)");
  const double limit = tree.getResolution() * (1 << (kDepth - 1)) / 2.0;
  const double *eye = origin.data(), *at = points.data();
  for (int k = 0; k < 3; ++k)
    if (!(std::abs(eye[k]) < limit)) throw std::invalid_argument("origin is not within the tree");
  octomap::Pointcloud cloud;
  cloud.reserve(static_cast<std::size_t>(points.shape(0)));
  for (py::ssize_t i = 0; i < points.shape(0); ++i, at += 3) {
    for (int k = 0; k < 3; ++k)
      if (!(std::abs(at[k]) < limit)) throw std::invalid_argument("a point is not within the tree");
    cloud.push_back(static_cast<float>(at[0]), static_cast<float>(at[1]), static_cast<float>(at[2]));
  }
  const octomap::point3d from(static_cast<float>(eye[0]), static_cast<float>(eye[1]), static_cast<float>(eye[2]));
  const py::gil_scoped_release release;
  // Of the points in one voxel, one ray is enough.
  tree.insertPointCloud(cloud, from, max_range_m, false, true);
}

py::bytes binary(const octomap::OcTree &tree) {
  std::ostringstream out;
  {
    const py::gil_scoped_release release;
    octomap::OcTree copy(tree);  // writing rounds each voxel to occupied or free
    if (!copy.writeBinary(out)) throw std::runtime_error("OctoMap could not serialise the tree");
  }
  return out.str();
}

// Depth first, as the file is: each inner node has two bits a child.
class Walk {
 public:
  Walk(std::string_view data, double resolution) : data_(data), resolution_(resolution) {}

  void node(int depth, double x, double y, double z) {
    if (depth >= kDepth) throw std::invalid_argument("is deeper than 16 levels");
    if (data_.size() - at_ < 2) throw std::invalid_argument("ends within a node");
    const unsigned bits = static_cast<unsigned char>(data_[at_]) | static_cast<unsigned char>(data_[at_ + 1]) << 8U;
    at_ += 2;
    const double side = std::ldexp(resolution_, kDepth - depth - 1), half = side / 2.0;
    for (unsigned child = 0; child < 8; ++child) {
      const unsigned kind = bits >> (2 * child) & 3U;  // unknown, free, occupied, inner
      if (kind == 0) continue;
      ++nodes;
      const double cx = x + ((child & 1U) != 0 ? half : -half), cy = y + ((child & 2U) != 0 ? half : -half),
                   cz = z + ((child & 4U) != 0 ? half : -half);
      if (kind == 2) occupied.insert(occupied.end(), {cx, cy, cz, side});
      if (kind == 3) inner_.push_back({depth + 1, cx, cy, cz});
    }
  }

  void all() {
    inner_.push_back({0, 0.0, 0.0, 0.0});
    // The children of a node follow it, first child first: what it pushed is taken up before what was there.
    while (!inner_.empty()) {
      const Inner next = inner_.back();
      inner_.pop_back();
      const std::size_t before = inner_.size();
      node(next.depth, next.x, next.y, next.z);
      for (std::size_t i = before, j = inner_.size(); i + 1 < j; ++i) std::swap(inner_[i], inner_[--j]);
    }
    if (at_ != data_.size()) throw std::invalid_argument("goes on after its last node");
  }

  std::size_t nodes = 1;
  std::vector<double> occupied;  // x, y, z and side of each

 private:
  struct Inner {
    int depth;
    double x, y, z;
  };
  std::string_view data_;
  double resolution_;
  std::size_t at_ = 0;
  std::vector<Inner> inner_;
};

py::tuple leaves(const std::string &data, double resolution_m) {
  Walk walk(data, resolution_m);
  {
    const py::gil_scoped_release release;
    walk.all();
  }
  const auto rows = static_cast<py::ssize_t>(walk.occupied.size() / 4);
  py::array_t<double> occupied({rows, py::ssize_t{4}}, walk.occupied.data());
  return py::make_tuple(walk.nodes, occupied);
}

}  // namespace

PYBIND11_MODULE(_octree, m) {
  m.doc() = "OctoMap's octree; use it through hitchhike_ros.mapping.octree.";
  py::class_<octomap::OcTree>(m, "Tree")
      .def(py::init<double>(), py::arg("resolution_m"))
      .def("insert", &insert, py::arg("points").noconvert(), py::arg("origin").noconvert(), py::arg("max_range_m"),
           "Rays from origin (3,) to points (N, 3) in m: free on the way, occupied where they end within the range.")
      .def("binary", &binary, "The .bt file.")
      .def("__len__", &octomap::OcTree::size, "How many nodes.");
  m.def("leaves", &leaves, py::arg("data"), py::arg("resolution_m"),
        "Number of nodes of the data of a .bt file, and occupied leaves (N, 4): centre and side in m.");
}
