#include "viewer/ui/menu.h"

#include <fmt/format.h>
#include <imgui.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>

#include "viewer/ui/texts.h"

namespace splatbus::viewer {
namespace {

/// A list of choices with a label; `text` names them. One that is none of them is shown as `now`.
void choice(const char* label, std::size_t count, std::optional<std::size_t> chosen, const std::string& now,
            const std::function<std::string(std::size_t)>& text, const std::function<void(std::size_t)>& choose) {
  if (!ImGui::BeginCombo(label, chosen ? text(*chosen).c_str() : now.c_str())) return;
  for (std::size_t i = 0; i < count; ++i) {
    if (ImGui::Selectable(text(i).c_str(), chosen == i)) choose(i);
    if (chosen == i) ImGui::SetItemDefaultFocus();
  }
  ImGui::EndCombo();
}

template <class Values, class Value>
std::optional<std::size_t> index_of(const Values& values, const Value& value) {
  const auto found = std::ranges::find(values, value);
  if (found == values.end()) return std::nullopt;
  return static_cast<std::size_t>(found - values.begin());
}

std::string count_text(std::size_t count) {
  const bool millions = count >= 1'000'000;
  const double tenths = std::round(static_cast<double>(count) / (millions ? 1e5 : 1e2));
  return fmt::format("{:g} {}", tenths / 10, millions ? 'M' : 'K');
}

std::string rate_text(std::uint32_t kbps) {
  return kbps == 0 ? texts::kNoLimit : fmt::format("{:g}", kbps / 1000.0);
}

void actions_of(const OverlayContent& content, std::vector<Action>& actions) {
  const auto button = [&](const char* text, Action action) {
    if (ImGui::Button(text)) actions.push_back(action);
  };
  button(texts::kFrameAll, Action::FrameAll);
  ImGui::SameLine();
  button(texts::kSnapshot, Action::Snapshot);
  const auto box = [&](const char* text, bool on, Action action) {
    if (ImGui::Checkbox(text, &on)) actions.push_back(action);
  };
  box(texts::kFullScreen, content.full_screen, Action::FullScreen);
  box(texts::kFigures, content.figures_shown, Action::Figures);
  if (content.player) box(texts::kFollow, content.following, Action::Follow);
}

void settings_of(OverlayContent& content) {
  Settings& settings = content.settings;
  choice(
      texts::kQuality, kResolutions.size(), index_of(kResolutions, settings.resolution), "",
      [](std::size_t i) { return texts::kQualities.at(i); },
      [&](std::size_t i) { settings.resolution = kResolutions.at(i); });
  if (content.streams) {
    choice(
        texts::kGaussianBudget, kGaussianBudgets.size(), index_of(kGaussianBudgets, settings.max_gaussians),
        count_text(settings.max_gaussians), [](std::size_t i) { return count_text(kGaussianBudgets.at(i)); },
        [&](std::size_t i) { settings.max_gaussians = kGaussianBudgets.at(i); });
    choice(
        texts::kRateBudget, kRateBudgets.size(), index_of(kRateBudgets, settings.max_kbps),
        rate_text(settings.max_kbps), [](std::size_t i) { return rate_text(kRateBudgets.at(i)); },
        [&](std::size_t i) { settings.max_kbps = kRateBudgets.at(i); });
  }
  std::optional<std::size_t> background = 0;
  if (settings.background) background = 1 + index_of(kBackgroundGrays, settings.background->x).value_or(0);
  choice(
      texts::kBackground, texts::kBackgrounds.size(), background, "",
      [](std::size_t i) { return texts::kBackgrounds.at(i); },
      [&](std::size_t i) {
        settings.background.reset();
        if (i > 0) settings.background = glm::vec3(kBackgroundGrays.at(i - 1));
      });
}

void save_of(std::vector<Action>& actions) {
  ImGui::Separator();
  ImGui::AlignTextToFramePadding();
  ImGui::TextUnformatted(texts::kSaveModel);
  for (const auto& [text, action] :
       {std::pair{".ply", Action::SavePly}, std::pair{".glb", Action::SaveGlb}, std::pair{".spz", Action::SaveSpz}}) {
    ImGui::SameLine();
    if (ImGui::Button(text)) actions.push_back(action);
  }
}

void keys() {
  ImGui::Separator();
  ImGui::TextUnformatted(texts::kKeys);
  if (!ImGui::BeginTable("keys", 2, ImGuiTableFlags_SizingFixedFit | ImGuiTableFlags_PadOuterX)) return;
  for (const auto& [key, what] : texts::kKeyList) {
    ImGui::TableNextColumn();
    ImGui::TextUnformatted(key);
    ImGui::TableNextColumn();
    ImGui::TextUnformatted(what);
  }
  ImGui::EndTable();
  ImGui::TextUnformatted(texts::kSteerHint);
}

}  // namespace

MenuPlace draw_menu(OverlayContent& content, std::vector<Action>& actions) {
  const ImVec2 display = ImGui::GetIO().DisplaySize;
  ImGui::SetNextWindowPos({display.x - kPanelMargin, kPanelMargin}, ImGuiCond_Always, {1, 0});
  ImGui::SetNextWindowSizeConstraints({0, 0}, {display.x - 2 * kPanelMargin, display.y - 2 * kPanelMargin});
  bool open = true;
  ImGui::Begin(texts::kMenu, &open,
               ImGuiWindowFlags_AlwaysAutoResize | ImGuiWindowFlags_NoCollapse | ImGuiWindowFlags_NoMove);
  ImGui::PushItemWidth(9 * ImGui::GetFontSize());
  actions_of(content, actions);
  ImGui::Separator();
  settings_of(content);
  ImGui::PopItemWidth();
  if (content.streams) save_of(actions);
  keys();
  if (ImGui::Button(texts::kClose) || !open) actions.push_back(Action::Close);
  const ImVec2 at = ImGui::GetWindowPos(), size = ImGui::GetWindowSize();
  ImGui::End();
  return {.left = at.x, .top = at.y, .right = at.x + size.x, .bottom = at.y + size.y};
}

}  // namespace splatbus::viewer
