// The pose of a square from its corners: projection and Jacobian, least squares, and the posterior of a marker that is
// seen nearly square-on. hitchhike_ros.servoing.square_pose says what is computed and why; here it is fast.

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <tuple>
#include <vector>

#include "visp_binding.h"

#include <Eigen/Dense>
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

namespace py = pybind11;

namespace {

template <int Rows, int Columns>
using Matrix = Eigen::Matrix<double, Rows, Columns, Columns == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
template <int Rows>
using Vector = Matrix<Rows, 1>;
using Pose = Matrix<4, 4>;
using Corners = Matrix<4, 2>;
// Pose, covariance (6, 6) without the size's share, and chi2 of the corners.
using Solution = std::tuple<Pose, Matrix<6, 6>, double>;

// Of Levenberg and Marquardt's steps, until chi2 changes by no more than that; a handful will do where the corners tell
// the pose.
constexpr int max_tries = 50;
constexpr double unchanged = 1e-9;
// Optima less than this apart are one.
constexpr double same_rad = 0.02;
// Yaws of the grid in units of flat_yaw: its ends are beyond doubt for whatever lies in [-1, 1].
constexpr int grid = 61, middle = grid / 2;
constexpr double grid_end = 1.5;
// Each yaw starts from the optima of those beside it, so that it takes one step, seldom two, until chi2 has settled.
constexpr int max_steps = 4;
constexpr double settled = 1e-3;
// Of 4 degrees of freedom; 1 upright marker in 20 000 has more (chosen).
constexpr double chi2_max = 25.0;
// Two optima are two poses if what lies between them is this much less likely, -2 log (chosen).
constexpr double ridge_min = 2.0;

// From the marker's centre to its corners along the camera's axes.
Matrix<4, 3> arms(const Pose &T, double size) {
  Matrix<4, 3> out;
  const Eigen::RowVector3d y = 0.5 * size * T.block<3, 1>(0, 1).transpose(), z = 0.5 * size * T.block<3, 1>(0, 2).transpose();
  out << -y - z, y - z, y + z, z - y;
  return out;
}

Corners project_corners(const Pose &T, double size) {
  const Matrix<4, 3> points = arms(T, size).rowwise() + T.block<3, 1>(0, 3).transpose();
  return points.leftCols<2>().array().colwise() / points.col(2).array();
}

Matrix<8, 6> corner_jacobian(const Pose &T, double size) {
  const Matrix<4, 3> arm = arms(T, size);
  Matrix<8, 6> J;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d a = arm.row(i), p = a + T.block<3, 1>(0, 3);
    for (int k = 0; k < 2; ++k) {
      Eigen::Vector3d row = Eigen::Vector3d::Zero();
      row[k] = 1 / p[2];
      row[2] = -p[k] / (p[2] * p[2]);
      J.row(2 * i + k) << row.transpose(), a.cross(row).transpose();
    }
  }
  return J;
}

// The inverse of the covariance's Cholesky factor: errors times that are independent, with variance 1.
Matrix<8, 8> whitening(const Matrix<8, 8> &covariance) {
  const Eigen::LLT<Matrix<8, 8>> factors(covariance);
  if (factors.info() != Eigen::Success) throw InvalidInput("covariance of the corners is not positive definite");
  return factors.matrixL().solve(Matrix<8, 8>::Identity());
}

// What is measured of a square: corners in normalised coordinates, and what whitens their errors.
struct View {
  Corners points;
  Matrix<8, 8> whitening;
  double size;

  Vector<8> misfit(const Pose &T) const {
    const Corners apart = project_corners(T, size) - points;
    return whitening.lazyProduct(Eigen::Map<const Vector<8>>(apart.data()));
  }
};

// The pose from the projective map of the square: exact where the corners are.
Pose closed_form(const View &view) {
  const Eigen::Vector2d ll = view.points.row(0), lr = view.points.row(1), ur = view.points.row(2), ul = view.points.row(3);
  Eigen::Matrix2d sides;
  sides << lr - ur, ul - ur;
  const Eigen::Vector2d bent = sides.inverse() * (ll - lr + ur - ul);
  Eigen::Vector3d right, up, centre;
  right << lr - ll + bent[0] * lr, bent[0];
  up << ul - ll + bent[1] * ul, bent[1];
  centre << ll, 1;
  centre += 0.5 * (right + up);
  const double scale = view.size / std::sqrt(right.norm() * up.norm());
  // The right angle nearest to what noise has made of it.
  right.normalize();
  up.normalize();
  const Eigen::Vector3d half = (right + up).normalized(), across = (right - up).normalized();
  Pose T = Pose::Identity();
  T.block<3, 1>(0, 0) = across.cross(half);
  T.block<3, 1>(0, 1) = (half + across) * M_SQRT1_2;
  T.block<3, 1>(0, 2) = (half - across) * M_SQRT1_2;
  T.block<3, 1>(0, 3) = scale * centre;
  return T;
}

// The plane's normal and the line of sight span the square-on ambiguity: a small square looks nearly the same when its
// normal is mirrored at the line of sight.
Pose mirrored(const Pose &T) {
  const Eigen::Vector3d back = -T.block<3, 1>(0, 3).normalized(), normal = T.block<3, 1>(0, 0);
  const Eigen::Quaterniond half = Eigen::Quaterniond::FromTwoVectors(normal, back);
  Pose out = T;
  out.block<3, 3>(0, 0) = (half * half).toRotationMatrix() * T.block<3, 3>(0, 0);
  return out;
}

Pose moved(const Pose &T, const Vector<6> &d) {
  Pose out = T;
  const Eigen::Vector3d turn = d.tail<3>();
  if (const double angle = turn.norm(); angle > 0)
    out.block<3, 3>(0, 0) = Eigen::AngleAxisd(angle, turn / angle) * T.block<3, 3>(0, 0);
  out.block<3, 1>(0, 3) += d.head<3>();
  return out;
}

// The pose near T that fits best; nothing where the corners do not determine it.
std::optional<Solution> least_squares(const View &view, Pose T) {
  double chi2 = view.misfit(T).squaredNorm(), damping = 1e-6;
  for (int i = 0; i < max_tries; ++i) {
    const Matrix<8, 6> A = view.whitening.lazyProduct(corner_jacobian(T, view.size));
    Matrix<6, 6> information = A.transpose().lazyProduct(A);
    information.diagonal() *= 1 + damping;
    const Pose next = moved(T, -information.ldlt().solve(A.transpose().lazyProduct(view.misfit(T))));
    const double then = view.misfit(next).squaredNorm();
    const double gain = chi2 - then;
    if (gain >= 0) {
      T = next;
      chi2 = then;
      damping *= 0.1;
    } else {
      damping *= 10;
    }
    if (!(std::fabs(gain) > unchanged)) break;
  }
  const Matrix<8, 6> A = view.whitening.lazyProduct(corner_jacobian(T, view.size));
  const Matrix<6, 6> information = A.transpose().lazyProduct(A);
  if (!information.allFinite() || !(T(2, 3) > 0)) return std::nullopt;
  const Vector<6> values =
      Eigen::SelfAdjointEigenSolver<Matrix<6, 6>>(information, Eigen::EigenvaluesOnly).eigenvalues();
  if (!(values[5] < 1e12 * values[0])) return std::nullopt;
  return Solution{T, information.inverse(), chi2};
}

// The one or two least-squares poses, the better one first.
std::vector<Solution> solve(const Corners &points, const Matrix<8, 8> &whitening, double size) {
  if (!(size > 0) || !std::isfinite(size))
    throw InvalidInput("marker size is " + std::to_string(size) + " m, expected more than 0");
  if (!points.allFinite()) throw InvalidInput("corners hold a number that is not finite");
  const View view{points, whitening, size};
  std::vector<Solution> solutions;
  std::optional<Solution> found = least_squares(view, closed_form(view));
  if (!found) return solutions;
  const Pose first = std::get<0>(*found);
  solutions.push_back(std::move(*found));
  found = least_squares(view, mirrored(first));
  if (!found) return solutions;
  const Eigen::AngleAxisd apart(Eigen::Matrix3d(first.block<3, 3>(0, 0).transpose() * std::get<0>(*found).block<3, 3>(0, 0)));
  if (apart.angle() > same_rad) solutions.push_back(std::move(*found));
  if (solutions.size() == 2 && std::get<2>(solutions[1]) < std::get<2>(solutions[0])) std::swap(solutions[0], solutions[1]);
  return solutions;
}

// Poses of markers by translation along the camera's axes, then roll, pitch and yaw in the base frame. A marker that hangs
// upside down is turned half a turn about its normal before it rolls.
struct Mounting {
  Eigen::Matrix3d R_camera_base;
  double upside;

  // And d(pose)/d(roll, pitch, yaw), along the camera's axes; that of the translation is 1.
  std::pair<Pose, Eigen::Matrix3d> pose(const Vector<6> &q) const {
    const double cr = std::cos(q[3]), cp = std::cos(q[4]), cy = std::cos(q[5]);
    const double sr = std::sin(q[3]), sp = std::sin(q[4]), sy = std::sin(q[5]);
    Eigen::Matrix3d R, axes;
    R << cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,  //
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,   //
        -sp, cp * sr, cp * cr;
    R.rightCols<2>() *= upside;
    // Roll turns about the normal, pitch about the level axis across it, yaw about the vertical.
    axes << cy * cp, -sy, 0,  //
        sy * cp, cy, 0,       //
        -sp, 0, 1;
    Pose T = Pose::Identity();
    T.block<3, 3>(0, 0) = R_camera_base * R;
    T.block<3, 1>(0, 3) = q.head<3>();
    return {T, R_camera_base * axes};
  }
};

// A yaw of the grid, with what is likeliest there for the other five parameters.
struct Slice {
  Vector<6> q;
  Matrix<6, 6> covariance;
  double chi2;
};

// Starts from the parameters q, and holds their yaw.
Slice best_at_yaw(const View &view, const Mounting &mounting, double upright_sigma, double yaw_variance, Vector<6> q) {
  Matrix<6, 6> covariance = Matrix<6, 6>::Zero();
  double chi2 = 0;
  for (int step = 0; step < max_steps; ++step) {
    const auto [T, turns] = mounting.pose(q);
    const Matrix<8, 6> J = corner_jacobian(T, view.size);
    Matrix<8, 5> A;
    A << J.leftCols<3>(), J.rightCols<3>() * turns.leftCols<2>();
    A = view.whitening.lazyProduct(A).eval();
    const Vector<8> e = view.misfit(T);
    const Eigen::Vector2d lean = q.segment<2>(3) / upright_sigma;
    Matrix<5, 5> information = A.transpose().lazyProduct(A);
    information.diagonal().tail<2>().array() += 1 / (upright_sigma * upright_sigma);
    Vector<5> gradient = A.transpose().lazyProduct(e);
    gradient.tail<2>() += lean / upright_sigma;
    const Eigen::LLT<Matrix<5, 5>> factors(information);
    const Vector<5> d = factors.solve(gradient);
    q.head<5>() -= d;
    const double gain = gradient.dot(d);
    chi2 = e.squaredNorm() + lean.squaredNorm() - gain;
    if (gain < settled || step == max_steps - 1) {
      covariance.topLeftCorner<5, 5>() = factors.solve(Matrix<5, 5>::Identity());
      break;
    }
  }
  covariance(5, 5) = yaw_variance;
  return {q, covariance, chi2};
}

// The grid as one mode, or as two where the least of chi2 on either side of square-on have a ridge between them: first
// and last yaw of each.
std::vector<std::pair<int, int>> modes_of(const std::array<Slice, grid> &slices) {
  const auto less = [](const Slice &a, const Slice &b) { return a.chi2 < b.chi2; };
  const auto left = std::min_element(slices.begin(), slices.begin() + middle + 1, less);
  const auto right = std::min_element(slices.begin() + middle, slices.end(), less);
  const auto ridge = std::max_element(left, right + 1, less);
  if (ridge->chi2 - std::max(left->chi2, right->chi2) < ridge_min) return {{0, grid - 1}};
  const int split = static_cast<int>(ridge - slices.begin());
  return {{0, split}, {split, grid - 1}};
}

std::vector<Solution> square_on_poses(const Corners &points, const Matrix<8, 8> &whitening, double size, const Pose &start,
                                      const Pose &T_base_camera, double upright_sigma, double flat) {
  const View view{points, whitening, size};
  const Pose T = T_base_camera * start;
  const Eigen::Vector3d sight = (T - T_base_camera).block<3, 1>(0, 3);
  const double square_on = std::atan2(-sight[1], -sight[0]);
  const Mounting mounting{T_base_camera.block<3, 3>(0, 0).transpose(), std::copysign(1.0, T(2, 2))};
  constexpr double spacing = 2 * grid_end / (grid - 1);
  const double step = flat * spacing, yaw_variance = step * step / 12;  // within a step of the grid
  std::array<Slice, grid> slices;
  const auto fill = [&](int i, Vector<6> q) {
    q[5] = square_on + flat * (i * spacing - grid_end);
    slices[static_cast<std::size_t>(i)] = best_at_yaw(view, mounting, upright_sigma, yaw_variance, q);
  };
  // From the start's own yaw to either side.
  const double own = std::remainder(std::atan2(T(1, 0), T(0, 0)) - square_on, 2 * M_PI) / step;
  const int first = middle + static_cast<int>(std::lround(std::clamp(own, -double(middle), double(middle))));
  Vector<6> q;
  q << start.block<3, 1>(0, 3), std::atan2(mounting.upside * T(2, 1), mounting.upside * T(2, 2)),
      -std::asin(std::clamp(T(2, 0), -1.0, 1.0)), 0;
  fill(first, q);
  const auto at = [&](int i) -> const Vector<6> & { return slices[static_cast<std::size_t>(i)].q; };
  for (int i = first + 1; i < grid; ++i) fill(i, i - first > 1 ? Vector<6>(2 * at(i - 1) - at(i - 2)) : at(first));
  for (int i = first - 1; i >= 0; --i) fill(i, first - i > 1 ? Vector<6>(2 * at(i + 1) - at(i + 2)) : at(first));
  const auto less = [](const Slice &a, const Slice &b) { return a.chi2 < b.chi2; };
  if (!std::all_of(slices.begin(), slices.end(), [](const Slice &slice) { return std::isfinite(slice.chi2); })) return {};
  if (std::min_element(slices.begin(), slices.end(), less)->chi2 >= chi2_max) return {};
  std::vector<Solution> solutions;
  for (const auto &[from, to] : modes_of(slices)) {
    const auto begin = slices.begin() + from, end = slices.begin() + to + 1;
    const auto best = std::min_element(begin, end, less);
    double total = 0;
    Vector<6> mean = Vector<6>::Zero();
    for (auto slice = begin; slice != end; ++slice) {
      const double w = std::exp(-0.5 * (slice->chi2 - best->chi2));
      total += w;
      mean += w * slice->q;
    }
    mean /= total;
    Matrix<6, 6> covariance = Matrix<6, 6>::Zero();
    for (auto slice = begin; slice != end; ++slice) {
      const double w = std::exp(-0.5 * (slice->chi2 - best->chi2)) / total;
      const Vector<6> d = slice->q - mean;
      covariance += w * (slice->covariance + d * d.transpose());
    }
    const auto [pose, turns] = mounting.pose(mean);
    Matrix<6, 6> G = Matrix<6, 6>::Identity();
    G.block<3, 3>(3, 3) = turns;
    const double of_corners = view.misfit(mounting.pose(best->q).first).squaredNorm();
    solutions.emplace_back(pose, G * covariance * G.transpose(), of_corners);
  }
  return solutions;
}

}  // namespace

void bind_square_pose(py::module_ &m) {
  using unlocked = py::call_guard<py::gil_scoped_release>;
  m.def("whitening", &whitening, py::arg("covariance"));
  m.def("project_corners", &project_corners, py::arg("T_camera_marker"), py::arg("size"));
  m.def("corner_jacobian", &corner_jacobian, py::arg("T_camera_marker"), py::arg("size"));
  m.def("solve", &solve, py::arg("points"), py::arg("whitening"), py::arg("size"), unlocked());
  m.def("square_on_poses", &square_on_poses, py::arg("points"), py::arg("whitening"), py::arg("size"), py::arg("start"),
        py::arg("T_base_camera"), py::arg("upright_sigma"), py::arg("flat"), unlocked());
}
