#include "viewer/path_file.h"

#include <fmt/format.h>

#include <cmath>
#include <cstddef>
#include <optional>
#include <sstream>

#include "bus/error.h"

namespace splatbus::viewer {

namespace {

constexpr double kFarthest_m = 1e5;
constexpr double kLeastNorm = 0.99, kMostNorm = 1.01;  // of a quaternion, written with a few digits

class PathReader {
 public:
  PathReader(const std::string& file, std::size_t columns, const char* format)
      : file_(file), in_(file), columns_(columns), format_(format) {
    if (!in_) throw bus::Error(file_ + ": cannot be read");
  }

  /// Hands each line's numbers to `row`, which is told whether a leg begins with it.
  template <class Row>
  void read(Row row) {
    std::string line;
    bool begins = true, any = false;
    while (std::getline(in_, line)) {
      ++line_;
      std::istringstream words(line.substr(0, line.find('#')));
      std::vector<std::string> parts;
      for (std::string word; words >> word;) parts.push_back(word);
      if (parts.empty()) continue;
      if (parts.size() == 1 && parts[0] == "teleport") {
        if (begins) refuse("a teleport from nowhere");
        begins = true;
        continue;
      }
      row(numbers(parts), begins);
      begins = false;
      any = true;
    }
    if (!any) throw bus::Error(file_ + ": it holds no point");
    if (begins) refuse("a teleport to nowhere");
  }

  [[noreturn]] void refuse(const std::string& why) const {
    throw bus::Error(fmt::format("{}:{}: {}", file_, line_, why));
  }

  [[nodiscard]] glm::vec3 point(const double* xyz) const {
    for (int axis = 0; axis < 3; ++axis) {
      if (std::abs(xyz[axis]) > kFarthest_m) refuse(fmt::format("{} m is too far out", xyz[axis]));
    }
    return {xyz[0], xyz[1], xyz[2]};
  }

 private:
  [[nodiscard]] std::vector<double> numbers(const std::vector<std::string>& parts) const {
    if (parts.size() != columns_) {
      refuse(fmt::format("{} words where '{}' or 'teleport' belongs", parts.size(), format_));
    }
    std::vector<double> values;
    for (const std::string& part : parts) {
      std::istringstream in(part);
      double value = 0;
      if (!(in >> value) || in.peek() != std::istringstream::traits_type::eof()) {
        refuse(fmt::format("'{}' is not a number", part));
      }
      values.push_back(value);
    }
    return values;
  }

  std::string file_;
  std::ifstream in_;
  std::size_t columns_;
  const char* format_;
  int line_ = 0;
};

}  // namespace

std::vector<PathLeg> read_path_points(const std::string& file) {
  PathReader reader(file, 3, "x y z");
  std::vector<PathLeg> legs;
  reader.read([&](const std::vector<double>& row, bool begins) {
    if (begins) legs.emplace_back();
    legs.back().push_back(reader.point(row.data()));
  });
  return legs;
}

std::vector<std::vector<TimedPose>> read_path_poses(const std::string& file) {
  PathReader reader(file, 8, "t x y z qw qx qy qz");
  std::vector<std::vector<TimedPose>> legs;
  std::optional<double> before_s;
  reader.read([&](const std::vector<double>& row, bool begins) {
    if (before_s && row[0] <= *before_s) reader.refuse(fmt::format("{} s comes after {} s", row[0], *before_s));
    before_s = row[0];
    const glm::dquat rotation(row[4], row[5], row[6], row[7]);
    const double norm = glm::length(rotation);
    if (norm < kLeastNorm || norm > kMostNorm) reader.refuse(fmt::format("a quaternion of length {}", norm));
    if (begins) legs.emplace_back();
    legs.back().push_back(
        {.time_s = row[0],
         .world_from_camera = {.rotation = glm::quat(rotation / norm), .translation = reader.point(row.data() + 1)}});
  });
  return legs;
}

PathRecorder::PathRecorder(const std::string& file) : file_(file), out_(file) {
  if (!(out_ << "# t x y z qw qx qy qz: seconds, metres, world from camera\n").flush()) {
    throw bus::Error(file_ + ": cannot be written");
  }
}

void PathRecorder::add(const TimedPose& pose) {
  if (pose.time_s <= last_s_) return;
  last_s_ = pose.time_s;
  const glm::quat& q = pose.world_from_camera.rotation;
  const glm::vec3& p = pose.world_from_camera.translation;
  // Whole lines, whenever the viewer ends.
  out_ << fmt::format("{:.4f} {:.5f} {:.5f} {:.5f} {:.7f} {:.7f} {:.7f} {:.7f}\n", pose.time_s, p.x, p.y, p.z, q.w, q.x,
                      q.y, q.z)
       << std::flush;
}

}  // namespace splatbus::viewer
