#include "viewer/ui/panels.h"

#include <spdlog/spdlog.h>

#include "bus/clock.h"

namespace splatbus::viewer {
namespace {

constexpr std::int64_t kRowsNs = 250'000'000;
constexpr std::int64_t kNoticeNs = 4'000'000'000;
// ImGui answers in the picture after the one that was touched, and fits its window in one more.
constexpr int kTouchedPictures = 3;

}  // namespace

void Panels::attach([[maybe_unused]] GLFWwindow* window) {
#ifdef SPLATBUS_HAVE_IMGUI
  overlay_ = make_overlay(window);
#endif
  touched_ = kTouchedPictures;
}

void Panels::touch() {
  if (content.menu) touched_ = kTouchedPictures;
}

void Panels::key(int key, int scancode, int action, int mods) {
  if (overlay_) overlay_->key(key, scancode, action, mods);
  touch();
}

void Panels::toggle_menu() {
  content.menu = !content.menu;
  touched_ = kTouchedPictures;
}

void Panels::toggle_figures() {
  shows_figures_ = !shows_figures_;
  rows_ns_ = 0;
  touched_ = kTouchedPictures;
}

bool Panels::close() {
  if (!overlay_ || !content.menu) return false;
  if (!overlay_->chooses()) toggle_menu();  // a list of choices closes by itself
  return true;
}

void Panels::say(const std::string& text) {
  spdlog::info("{}", text);
  passing_notice_ = text;
  notice_until_ns_ = bus::now_ns() + kNoticeNs;
}

void Panels::renew() {
  const std::int64_t now_ns = bus::now_ns();
  content.notice = now_ns < notice_until_ns_ ? passing_notice_ : kept_notice_;
  if (now_ns - rows_ns_ < kRowsNs) return;
  rows_ns_ = now_ns;
  content.figures_shown = shows_figures_;
  content.figures.clear();
  if (shows_figures_) {
    content.figures = figure_rows(figures_, frame_rate_.frame_ms(now_ns), content.settings.resolution);
  }
}

bool Panels::due() {
  if (!overlay_) return false;
  renew();
  return touched_ > 0 || content.figures != drawn_figures_ || content.notice != drawn_notice_;
}

std::vector<Action> Panels::draw(bool new_picture) {
  if (new_picture) frame_rate_.drawn(bus::now_ns());
  if (!overlay_) return {};
  renew();
  if (touched_ > 0) --touched_;
  drawn_figures_ = content.figures;
  drawn_notice_ = content.notice;
  std::vector<Action> actions = overlay_->draw(content);
  if (!actions.empty() || overlay_->has_keys()) touched_ = kTouchedPictures;
  return actions;
}

}  // namespace splatbus::viewer
