#pragma once

#include <array>
#include <utility>

// Every text of the window that a person reads, as far as they can the page's (web/src/texts.ts).
namespace splatbus::viewer::texts {

inline constexpr const char* kMenu = "Menu";
inline constexpr const char* kClose = "Close";
inline constexpr const char* kFrameAll = "Show all";
inline constexpr const char* kFullScreen = "Full screen";
inline constexpr const char* kSnapshot = "Save picture";
inline constexpr const char* kFigures = "Figures";
inline constexpr const char* kFollow = "Follow the player";
inline constexpr const char* kQuality = "Quality";
inline constexpr std::array kQualities{"Full", "High", "Medium", "Low"};
inline constexpr const char* kGaussianBudget = "Gaussians at most";
inline constexpr const char* kRateBudget = "Mbit/s at most";
inline constexpr const char* kNoLimit = "As the server likes";
inline constexpr const char* kBackground = "Background";
inline constexpr std::array kBackgrounds{"The scene's", "Black", "Gray", "White"};
inline constexpr const char* kSaveModel = "Save the model";
inline constexpr const char* kKeys = "Keys";
inline constexpr std::array kKeyList{
    std::pair{"W A S D", "move; ahead is where you look"},
    std::pair{"Q E", "down, up"},
    std::pair{"Shift", "faster"},
    std::pair{"Arrows", "turn; in the menu, choose"},
    std::pair{"+ -", "nearer, farther"},
    std::pair{"F", "show all"},
    std::pair{"G", "follow the player"},
    std::pair{"I", "figures"},
    std::pair{"M", "menu"},
    std::pair{"P", "save picture"},
    std::pair{"V F11", "full screen"},
    std::pair{"Escape", "menu, full screen or window: close"},
    std::pair{"Drag", "orbit; with Shift or another button, pan"},
    std::pair{"Wheel", "nearer, farther"},
};
inline constexpr const char* kSteerHint = "A click into the picture gives it the keys.";

inline constexpr const char* kFrames = "Frames/s";
inline constexpr const char* kAtRest = "at rest";
inline constexpr const char* kFrame = "Frame";
inline constexpr const char* kGaussians = "Gaussians";
inline constexpr const char* kDrawn = "Drawn";
inline constexpr const char* kRate = "Mbit/s";
inline constexpr const char* kRoundTrip = "Round trip";
inline constexpr const char* kAge = "Picture age";
inline constexpr const char* kMissing = "Missing";
inline constexpr const char* kNothing = "nothing";
inline constexpr const char* kOnePage = "1 page";
inline constexpr const char* kPages = "{} pages";
inline constexpr const char* kResolution = "Resolution";
inline constexpr const char* kConnection = "Connection";
inline constexpr const char* kConnected = "Connected";
inline constexpr const char* kConnecting = "Connecting";
inline constexpr const char* kUnknown = "-";

inline constexpr const char* kFollowing = "Following the player. Any other movement ends it.";
inline constexpr const char* kNoPlayer = "The engine offers no player to follow.";
inline constexpr const char* kSaving = "The model is being saved.";
inline constexpr const char* kStillSaving = "The model is still being saved.";
inline constexpr const char* kNoModel = "The model is not here yet.";
inline constexpr const char* kSaved = "Saved: {}";
inline constexpr const char* kNoPicture = "There is no picture yet.";
inline constexpr const char* kReconnecting = "No connection. Trying again.";
inline constexpr const char* kWaiting = "Connected. Waiting for the first of the scene.";

}  // namespace splatbus::viewer::texts
