// Shortest paths on 8-connected grids: the compiled twin of planning/astar.py, which specifies the costs.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <queue>
#include <string>
#include <utility>
#include <vector>

namespace py = pybind11;

namespace {

using Costs = py::array_t<float, py::array::c_style>;
using Cell = std::pair<std::int32_t, std::int32_t>;  // row, column

constexpr double kInfinity = std::numeric_limits<double>::infinity();
const double kDiagonal = std::sqrt(2.0);

// Steps in the order east, west, north, south, then the diagonals between them.
constexpr int kRowStep[8] = {0, 0, 1, -1, 1, -1, 1, -1};
constexpr int kColumnStep[8] = {1, -1, 0, 0, 1, 1, -1, -1};
constexpr std::uint8_t kExpanded = 8;  // a flag beside the steps 0 to 7

// False for infinity, NaN and everything that would make the heuristic overestimate.
inline bool passable(float cost) { return cost >= 1.0F && cost < std::numeric_limits<float>::infinity(); }

struct Open {
  double f;           // cost from the start plus heuristic
  float h;            // the heuristic alone; it only decides among equals
  std::int32_t cell;  // 16 bytes in all: the heap is what the search waits for
};

// The least f first; among equals the one nearer to the goal, then the lower cell.
struct Later {
  bool operator()(const Open& a, const Open& b) const {
    if (a.f != b.f) return a.f > b.f;
    if (a.h != b.h) return a.h > b.h;
    return a.cell > b.cell;
  }
};

struct Found {
  std::vector<std::int32_t> cells;  // from start to goal; empty when there is no path
  double cost = kInfinity;
  std::int64_t expanded = 0;
};

Found search(const float* costs, std::int32_t height, std::int32_t width, Cell start, Cell goal) {
  const std::int32_t first = start.first * width + start.second;
  const std::int32_t last = goal.first * width + goal.second;
  Found found;
  if (!passable(costs[first]) || !passable(costs[last])) return found;

  const std::size_t size = static_cast<std::size_t>(height) * static_cast<std::size_t>(width);
  std::vector<double> g(size, kInfinity);
  std::vector<std::uint8_t> step_to(size, 0);  // index of the step by which a cell was reached, and kExpanded
  std::vector<Open> storage;
  storage.reserve(4096);
  std::priority_queue<Open, std::vector<Open>, Later> open(Later(), std::move(storage));

  const auto heuristic = [goal](std::int32_t row, std::int32_t column) {
    const double dr = std::abs(row - goal.first), dc = std::abs(column - goal.second);
    return std::max(dr, dc) + (kDiagonal - 1.0) * std::min(dr, dc);
  };

  std::int32_t offset[8];
  for (int i = 0; i < 8; ++i) offset[i] = kRowStep[i] * width + kColumnStep[i];

  g[first] = 0.0;
  open.push({heuristic(start.first, start.second), 0.0F, first});
  while (!open.empty()) {
    const std::int32_t here = open.top().cell;
    open.pop();
    if (step_to[here] & kExpanded) continue;  // it was pushed again when a cheaper way to it was found
    step_to[here] |= kExpanded;
    ++found.expanded;
    if (here == last) break;

    const std::int32_t row = here / width, column = here % width;
    const double g_here = g[here], cost_here = costs[here];
    const auto relax = [&](int i) {
      const std::int32_t next = here + offset[i];
      if (step_to[next] & kExpanded) return;
      const double g_next = g_here + (i < 4 ? 1.0 : kDiagonal) * (cost_here + costs[next]) / 2.0;
      if (g_next < g[next]) {
        g[next] = g_next;
        step_to[next] = static_cast<std::uint8_t>(i);
        const double h = heuristic(row + kRowStep[i], column + kColumnStep[i]);
        open.push({g_next + h, static_cast<float>(h), next});
      }
    };
    const bool east = column + 1 < width && passable(costs[here + 1]);
    const bool west = column > 0 && passable(costs[here - 1]);
    const bool north = row + 1 < height && passable(costs[here + width]);
    const bool south = row > 0 && passable(costs[here - width]);
    if (east) relax(0);
    if (west) relax(1);
    if (north) relax(2);
    if (south) relax(3);
    if (north && east && passable(costs[here + offset[4]])) relax(4);
    if (south && east && passable(costs[here + offset[5]])) relax(5);
    if (north && west && passable(costs[here + offset[6]])) relax(6);
    if (south && west && passable(costs[here + offset[7]])) relax(7);
  }

  found.cost = g[last];
  if (found.cost < kInfinity) {
    for (std::int32_t cell = last; cell != first; cell -= offset[step_to[cell] & ~kExpanded]) {
      found.cells.push_back(cell);
    }
    found.cells.push_back(first);
    std::reverse(found.cells.begin(), found.cells.end());
  }
  return found;
}

void require_inside(const char* what, Cell cell, std::int32_t height, std::int32_t width) {
  if (cell.first < 0 || cell.first >= height || cell.second < 0 || cell.second >= width) {
    throw py::index_error(std::string(what) + " (" + std::to_string(cell.first) + ", " + std::to_string(cell.second) +
                          ") is outside the grid of " + std::to_string(height) + " x " + std::to_string(width));
  }
}

py::tuple astar(const Costs& cost, Cell start, Cell goal) {
  if (cost.ndim() != 2) throw py::value_error("cost has " + std::to_string(cost.ndim()) + " dimensions, expected 2");
  if (cost.size() > std::numeric_limits<std::int32_t>::max()) throw py::value_error("cost has too many cells");
  const auto height = static_cast<std::int32_t>(cost.shape(0)), width = static_cast<std::int32_t>(cost.shape(1));
  require_inside("start", start, height, width);
  require_inside("goal", goal, height, width);

  const float* costs = cost.data();
  Found found;
  {
    const py::gil_scoped_release release;
    found = search(costs, height, width, start, goal);
  }
  py::array_t<std::int64_t> cells({static_cast<py::ssize_t>(found.cells.size()), py::ssize_t{2}});
  auto rows = cells.mutable_unchecked<2>();
  for (std::size_t i = 0; i < found.cells.size(); ++i) {
    const auto k = static_cast<py::ssize_t>(i);
    rows(k, 0) = found.cells[i] / width;
    rows(k, 1) = found.cells[i] % width;
  }
  return py::make_tuple(cells, found.cost, found.expanded);
}

}  // namespace

PYBIND11_MODULE(_grid_search, m) {
  m.doc() = "Compiled searches on grids; use them through hitchhike_ros.planning.astar.";
  m.def("astar", &astar, py::arg("cost").noconvert(), py::arg("start"), py::arg("goal"),
        "Cells (N, 2), cost and number of expanded cells; no cells and infinite cost when there is no path.");
}
