// Shortest paths on 8-connected grids: the compiled twins of planning/astar.py, which specifies the costs, and of
// planning/dstar_lite.py.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <new>
#include <stdexcept>
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
constexpr std::uint8_t kExpanded = 16;  // a flag beside 1 + the steps 0 to 7

// False for infinity, NaN and everything that would make the heuristic overestimate.
inline bool passable(float cost) { return cost >= 1.0F && cost < std::numeric_limits<float>::infinity(); }

// An entry of the heap: the least estimate first; among equals the one nearer to the goal, then the lower cell. All are
// whole numbers in the order of what they stand for, as bits of positive numbers are, so that comparing needs no branch
// that a processor could guess wrong: the heap is what the search waits for.
struct Open {
  std::uint64_t f;     // cost from the start plus heuristic
  std::uint64_t rest;  // the heuristic alone, and the cell

  Open(double estimate, float h, std::int32_t cell) {
    std::uint32_t bits;
    std::memcpy(&f, &estimate, sizeof f);
    std::memcpy(&bits, &h, sizeof bits);
    rest = static_cast<std::uint64_t>(bits) << 32 | static_cast<std::uint32_t>(cell);
  }
  std::int32_t cell() const { return static_cast<std::int32_t>(rest & 0xFFFFFFFFU); }
};

inline bool before(const Open& a, const Open& b) {
  return (a.f < b.f) | ((a.f == b.f) & (a.rest < b.rest));
}

// A heap with four children to a node: half as deep as a binary one, and the children lie side by side. One entry may
// wait outside, so that a cell which is both reached and expanded next never enters it.
class OpenCells {
 public:
  bool empty() const { return !waits_ && heap_.empty(); }

  void push(Open entry) {
    if (waits_) {
      if (before(entry, waiting_)) std::swap(entry, waiting_);
      insert(entry);
    } else {
      waiting_ = entry;
      waits_ = true;
    }
  }

  std::int32_t pop() {
    if (waits_ && (heap_.empty() || before(waiting_, heap_.front()))) {
      waits_ = false;
      return waiting_.cell();
    }
    const std::int32_t cell = heap_.front().cell();
    remove_front();
    return cell;
  }

 private:
  void insert(const Open& entry) {
    std::size_t hole = heap_.size();
    heap_.push_back(entry);
    for (; hole > 0; hole = (hole - 1) / 4) {
      const Open& parent = heap_[(hole - 1) / 4];
      if (!before(entry, parent)) break;
      heap_[hole] = parent;
    }
    heap_[hole] = entry;
  }

  void remove_front() {
    const Open last = heap_.back();
    heap_.pop_back();
    const std::size_t size = heap_.size();
    if (size == 0) return;
    std::size_t hole = 0;
    for (std::size_t child = 1; child < size; child = 4 * hole + 1) {
      std::size_t least = child;
      const std::size_t end = std::min(child + 4, size);
      for (std::size_t other = child + 1; other < end; ++other) {
        least = before(heap_[other], heap_[least]) ? other : least;
      }
      if (!before(heap_[least], last)) break;
      heap_[hole] = heap_[least];
      hole = least;
    }
    heap_[hole] = last;
  }

  std::vector<Open> heap_;
  Open waiting_{0.0, 0.0F, 0};
  bool waits_ = false;
};

// What is known of a cell; all zero for one that was not reached, so that fresh pages of memory need no filling.
struct Reached {
  double g;
  std::uint8_t state;  // 1 + the step by which it was reached; kExpanded
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
  struct Free {
    void operator()(void* memory) const { std::free(memory); }
  };
  const std::unique_ptr<Reached[], Free> reached(static_cast<Reached*>(std::calloc(size, sizeof(Reached))));
  if (!reached) throw std::bad_alloc();
  OpenCells open;

  const auto heuristic = [goal](std::int32_t row, std::int32_t column) {
    const double dr = std::abs(row - goal.first), dc = std::abs(column - goal.second);
    return std::max(dr, dc) + (kDiagonal - 1.0) * std::min(dr, dc);
  };

  std::int32_t offset[8];
  for (int i = 0; i < 8; ++i) offset[i] = kRowStep[i] * width + kColumnStep[i];

  open.push({heuristic(start.first, start.second), 0.0F, first});
  while (!open.empty()) {
    const std::int32_t here = open.pop();
    if (reached[here].state & kExpanded) continue;  // it was pushed again when a cheaper way to it was found
    reached[here].state |= kExpanded;
    ++found.expanded;
    if (here == last) break;

    const std::int32_t row = here / width, column = here % width;
    const double g_here = reached[here].g, cost_here = costs[here];
    const auto relax = [&](int i) {
      const std::int32_t next = here + offset[i];
      Reached& there = reached[next];
      if (there.state & kExpanded) return;
      const double g = g_here + (i < 4 ? 1.0 : kDiagonal) * (cost_here + costs[next]) / 2.0;
      if (there.state == 0 || g < there.g) {
        there.g = g;
        there.state = static_cast<std::uint8_t>(i + 1);
        const double h = heuristic(row + kRowStep[i], column + kColumnStep[i]);
        open.push({g + h, static_cast<float>(h), next});
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

  if (reached[last].state & kExpanded) {
    found.cost = reached[last].g;
    for (std::int32_t cell = last; cell != first; cell -= offset[(reached[cell].state & ~kExpanded) - 1]) {
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

void require_grid(const Costs& cost) {
  if (cost.ndim() != 2) throw py::value_error("cost has " + std::to_string(cost.ndim()) + " dimensions, expected 2");
  // With room for a border of one cell.
  if ((cost.shape(0) + 2) * (cost.shape(1) + 2) > std::numeric_limits<std::int32_t>::max()) {
    throw py::value_error("cost has too many cells");
  }
}

py::tuple to_python(const Found& found, std::int32_t width) {
  py::array_t<std::int64_t> cells({static_cast<py::ssize_t>(found.cells.size()), py::ssize_t{2}});
  auto rows = cells.mutable_unchecked<2>();
  for (std::size_t i = 0; i < found.cells.size(); ++i) {
    const auto k = static_cast<py::ssize_t>(i);
    rows(k, 0) = found.cells[i] / width;
    rows(k, 1) = found.cells[i] % width;
  }
  return py::make_tuple(cells, found.cost, found.expanded);
}

py::tuple astar(const Costs& cost, Cell start, Cell goal) {
  require_grid(cost);
  const auto height = static_cast<std::int32_t>(cost.shape(0)), width = static_cast<std::int32_t>(cost.shape(1));
  require_inside("start", start, height, width);
  require_inside("goal", goal, height, width);

  const float* costs = cost.data();
  Found found;
  {
    const py::gil_scoped_release release;
    found = search(costs, height, width, start, goal);
  }
  return to_python(found, width);
}

// Follows the paper's optimised version (Koenig and Likhachev, 2002, Fig. 4), with three things of its own:
// - A cell remembers the step that its rhs comes from. When a cell's g rises, the neighbours that step to it are those
//   whose rhs has to be looked for again; the paper finds them by comparing sums for equality.
// - Nothing is ever removed from the middle of the heap: an entry counts as long as its cell is inconsistent and still
//   has the entry's min(g, rhs). The rest of a key needs no comparison, as old keys are only ever too low, and what is
//   too low is put back with its new key, as in the paper.
// - A changed cell also opens or closes the diagonals between its neighbours, so all within one step look again.
class DStarLite {
 public:
  explicit DStarLite(const Costs& cost) {
    require_grid(cost);
    height_ = static_cast<std::int32_t>(cost.shape(0));
    width_ = static_cast<std::int32_t>(cost.shape(1));
    stride_ = width_ + 2;
    for (int i = 0; i < 8; ++i) offset_[i] = kRowStep[i] * stride_ + kColumnStep[i];
    // A border of blocked cells, so that every cell of the grid has eight neighbours.
    nodes_.resize(static_cast<std::size_t>(height_ + 2) * static_cast<std::size_t>(stride_));
    const auto values = cost.unchecked<2>();
    for (std::int32_t row = 0; row < height_; ++row) {
      for (std::int32_t column = 0; column < width_; ++column) {
        require_limited(values(row, column));
        set_cost(index({row, column}), values(row, column));
      }
    }
  }

  py::tuple plan(Cell start, Cell goal) {
    require_inside("start", start, height_, width_);
    require_inside("goal", goal, height_, width_);
    return run([&] {
      for (Node& node : nodes_) {
        node.g = node.rhs = kInfinity;
        node.next = kNone;
      }
      open_.clear();
      offset_of_keys_ = 0.0;
      start_ = last_ = index(start);
      goal_ = index(goal);
      nodes_[goal_].rhs = 0.0;
      push(key(goal_));
    });
  }

  py::tuple move(Cell start) {
    require_inside("start", start, height_, width_);
    if (goal_ == kNowhere) throw py::value_error("move before the first plan");
    return run([&] { start_ = index(start); });
  }

  void change(const py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>& cells, const Costs& cost) {
    if (cells.ndim() != 2 || cells.shape(1) != 2 || cost.ndim() != 1 || cost.shape(0) != cells.shape(0)) {
      throw py::value_error("expected cells (N, 2) and costs (N,)");
    }
    const auto at = cells.unchecked<2>();
    const auto values = cost.unchecked<1>();
    for (py::ssize_t k = 0; k < at.shape(0); ++k) {
      if (at(k, 0) < 0 || at(k, 0) >= height_ || at(k, 1) < 0 || at(k, 1) >= width_) {
        throw py::index_error("cell (" + std::to_string(at(k, 0)) + ", " + std::to_string(at(k, 1)) +
                              ") is outside the grid of " + std::to_string(height_) + " x " + std::to_string(width_));
      }
      require_limited(values(k));
    }
    const py::gil_scoped_release release;
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto cell_at = [&](py::ssize_t k) {
      return index({static_cast<std::int32_t>(at(k, 0)), static_cast<std::int32_t>(at(k, 1))});
    };
    for (py::ssize_t k = 0; k < at.shape(0); ++k) set_cost(cell_at(k), values(k));
    if (goal_ == kNowhere) return;
    follow_robot();
    for (py::ssize_t k = 0; k < at.shape(0); ++k) {
      const std::int32_t cell = cell_at(k);
      look_again(cell);
      for (const std::int32_t offset : offset_) look_again(cell + offset);
    }
  }

 private:
  static constexpr std::uint8_t kNone = 8;
  static constexpr std::int32_t kNowhere = -1;
  // The heuristic is this much of the octile distance: on free grids f is the same all along a path, and rounding must
  // not end the search before a cell of the path whose g is out of date. For the same reason costs are limited: the sum
  // over ten thousand of the dearest cells is still told apart from one that is a thousandth of a step longer.
  static constexpr double kOfOctile = 1.0 - 1e-3;
  static constexpr float kDearest = 1e6F;

  struct Node {
    double g = kInfinity, rhs = kInfinity;
    float cost = std::numeric_limits<float>::infinity();  // infinite for everything that is not passable
    std::uint8_t next = kNone;                            // step to the neighbour that rhs comes from
  };

  struct Key {
    double f, g;
    std::int32_t cell;
    bool operator<(const Key& other) const { return f != other.f ? f < other.f : g < other.g; }
    bool operator>(const Key& other) const { return other < *this; }
  };

  std::int32_t index(Cell cell) const { return (cell.first + 1) * stride_ + cell.second + 1; }

  static void require_limited(float cost) {
    if (passable(cost) && cost > kDearest) {
      throw py::value_error("cost " + std::to_string(cost) + ", expected at most 1e6, or infinity");
    }
  }

  void set_cost(std::int32_t cell, float cost) {
    nodes_[cell].cost = passable(cost) ? cost : std::numeric_limits<float>::infinity();
  }

  double distance(std::int32_t a, std::int32_t b) const {
    const double dr = std::abs(a / stride_ - b / stride_), dc = std::abs(a % stride_ - b % stride_);
    return kOfOctile * (std::max(dr, dc) + (kDiagonal - 1.0) * std::min(dr, dc));
  }

  // Cost of step i from a cell, infinite where it is not allowed.
  double step(std::int32_t cell, int i) const {
    if (i >= 4 && (nodes_[cell + kRowStep[i] * stride_].cost == kInfinity ||
                   nodes_[cell + kColumnStep[i]].cost == kInfinity)) {
      return kInfinity;
    }
    const double here = nodes_[cell].cost;
    return (i < 4 ? 1.0 : kDiagonal) * (here + nodes_[cell + offset_[i]].cost) / 2.0;
  }

  static int opposite(int i) { return i < 4 ? i ^ 1 : 11 - i; }

  // What a cell's place in the heap depends on beside the robot; negative for a cell that is not in it.
  static double queued(const Node& node) { return node.g == node.rhs ? -1.0 : std::min(node.g, node.rhs); }

  Key key(std::int32_t cell) const {
    const double g = std::min(nodes_[cell].g, nodes_[cell].rhs);
    return {g + distance(start_, cell) + offset_of_keys_, g, cell};
  }

  void push(const Key& entry) {
    open_.push_back(entry);
    std::push_heap(open_.begin(), open_.end(), std::greater<>());
  }

  void pop() {
    std::pop_heap(open_.begin(), open_.end(), std::greater<>());
    open_.pop_back();
  }

  // Sets g or rhs of a cell by ``set`` and puts the cell into the heap if it belongs at another place now.
  template <typename Set>
  void update(std::int32_t cell, Set set) {
    Node& node = nodes_[cell];
    const double before = queued(node);
    set(node);
    const double after = queued(node);
    if (after >= 0.0 && after != before) push(key(cell));
  }

  void look_again(std::int32_t cell) {
    if (cell == goal_) return;
    double rhs = kInfinity;
    std::uint8_t next = kNone;
    if (nodes_[cell].cost < kInfinity) {  // never true of the border, which has no eight neighbours
      for (int i = 0; i < 8; ++i) {
        const double through = step(cell, i) + nodes_[cell + offset_[i]].g;
        if (through < rhs) {
          rhs = through;
          next = static_cast<std::uint8_t>(i);
        }
      }
    }
    update(cell, [&](Node& node) {
      node.rhs = rhs;
      node.next = next;
    });
  }

  // Old keys stay below the true ones when the robot moves, as all new ones are raised by the way it has gone.
  void follow_robot() {
    offset_of_keys_ += distance(last_, start_);
    last_ = start_;
  }

  std::int64_t repair() {
    follow_robot();
    if (open_.size() > nodes_.size()) {  // mostly entries that no longer count
      open_.clear();
      for (std::int32_t cell = 0; cell < static_cast<std::int32_t>(nodes_.size()); ++cell) {
        if (queued(nodes_[cell]) >= 0.0) push(key(cell));
      }
    }
    std::int64_t expanded = 0;
    const Node& robot = nodes_[start_];
    while (!open_.empty()) {
      const Key top = open_.front();
      Node& node = nodes_[top.cell];
      if (queued(node) != top.g) {
        pop();
        continue;
      }
      if (!(top < key(start_)) && robot.rhs <= robot.g) break;
      pop();
      const Key now = key(top.cell);
      if (top < now) {
        push(now);
        continue;
      }
      ++expanded;
      if (node.g > node.rhs) {
        const double g = node.g = node.rhs;
        for (int i = 0; i < 8; ++i) {
          const std::int32_t cell = top.cell + offset_[i];
          const double through = step(top.cell, i) + g;
          if (through < nodes_[cell].rhs) {
            update(cell, [&](Node& neighbour) {
              neighbour.rhs = through;
              neighbour.next = static_cast<std::uint8_t>(opposite(i));
            });
          }
        }
      } else {
        update(top.cell, [](Node& raised) { raised.g = kInfinity; });
        for (int i = 0; i < 8; ++i) {
          const std::int32_t cell = top.cell + offset_[i];
          if (nodes_[cell].next == opposite(i)) look_again(cell);
        }
      }
    }
    return expanded;
  }

  // Prepares by ``prepare``, repairs, and follows the steps from the robot to the goal.
  template <typename Prepare>
  py::tuple run(Prepare prepare) {
    Found found;
    {
      const py::gil_scoped_release release;
      const std::lock_guard<std::mutex> lock(mutex_);
      prepare();
      found.expanded = repair();
      if (nodes_[start_].cost < kInfinity && nodes_[goal_].cost < kInfinity) found.cost = nodes_[start_].rhs;
      if (found.cost < kInfinity) {
        for (std::int32_t cell = start_;; cell += offset_[nodes_[cell].next]) {
          found.cells.push_back((cell / stride_ - 1) * width_ + cell % stride_ - 1);
          if (cell == goal_) break;
          if (nodes_[cell].next == kNone || found.cells.size() > nodes_.size()) {
            throw std::logic_error("D* Lite lost its path");  // rather than walk off the grid or for ever
          }
        }
      }
    }
    return to_python(found, width_);
  }

  std::int32_t height_, width_, stride_;
  std::int32_t offset_[8];
  std::vector<Node> nodes_;
  std::vector<Key> open_;  // a heap, the least key on top
  double offset_of_keys_ = 0.0;  // k_m of the paper
  std::int32_t start_ = kNowhere, last_ = kNowhere, goal_ = kNowhere;
  std::mutex mutex_;
};

}  // namespace

PYBIND11_MODULE(_grid_search, m) {
  m.doc() = "Compiled searches on grids; use them through hitchhike_ros.planning.astar and dstar_lite.";
  m.def("astar", &astar, py::arg("cost").noconvert(), py::arg("start"), py::arg("goal"),
        "Cells (N, 2), cost and number of expanded cells; no cells and infinite cost when there is no path.");
  py::class_<DStarLite>(m, "DStarLite")
      .def(py::init<const Costs&>(), py::arg("cost").noconvert())
      .def("plan", &DStarLite::plan, py::arg("start"), py::arg("goal"), "As astar; later calls of move build on it.")
      .def("move", &DStarLite::move, py::arg("start"), "As plan, for the same goal, with what is still valid kept.")
      .def("change", &DStarLite::change, py::arg("cells"), py::arg("costs").noconvert(),
           "Give cells (N, 2) new costs (N,).");
}
