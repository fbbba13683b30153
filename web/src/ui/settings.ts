// What a person chose, kept by the browser for the next time.
import type { Scene } from '../records';
import type { Budget } from '../stream/messages';

export type Quality = 'auto' | 'full' | 'high' | 'medium' | 'low';
export type Background = 'scene' | 'black' | 'gray' | 'white';

export type Speed = 'slow' | 'normal' | 'fast' | 'fastest';

export interface Settings {
  quality: Quality;
  background: Background;
  /** Of the camera that flies. */
  speed: Speed;
  /** Whether figures are over the picture; null: as the screen has room for them. */
  figures: boolean | null;
  budget: Budget;
}

export const kResolutions: Readonly<Record<Exclude<Quality, 'auto'>, number>> = { full: 1, high: 0.75, medium: 0.5, low: 0.35 };
const kBackgrounds: Readonly<Record<Exclude<Background, 'scene'>, [number, number, number]>> = {
  black: [0, 0, 0],
  gray: [0.2, 0.2, 0.2],
  white: [1, 1, 1],
};
/** The scene before the background that was chosen. */
export const sceneBefore = (background: Background, scene: Scene): Scene =>
  background === 'scene' ? scene : { ...scene, background: kBackgrounds[background] };
export const kSpeeds: Readonly<Record<Speed, number>> = { slow: 0.25, normal: 1, fast: 3, fastest: 10 };
/** Mbit/s; 0: as the streamer likes. */
export const kRateBudgets = [0, 1, 2, 5, 10, 20, 50] as const;
export const kGaussianBudgets = [100_000, 300_000, 1_000_000, 2_000_000, 4_000_000] as const;

const kKey = 'splatbus.settings';
const kDefaults: Settings = {
  quality: 'auto',
  background: 'scene',
  speed: 'normal',
  figures: null,
  budget: { gaussians: 1_000_000, megabits: 0 },
};

export function loadSettings(): Settings {
  try {
    const kept = JSON.parse(localStorage.getItem(kKey) ?? '{}') as Partial<Settings>;
    return {
      quality: kept.quality && (kept.quality === 'auto' || kept.quality in kResolutions) ? kept.quality : kDefaults.quality,
      background: kept.background && (kept.background === 'scene' || kept.background in kBackgrounds) ? kept.background : kDefaults.background,
      speed: kept.speed && kept.speed in kSpeeds ? kept.speed : kDefaults.speed,
      figures: typeof kept.figures === 'boolean' ? kept.figures : kDefaults.figures,
      budget: {
        gaussians: kept.budget && kept.budget.gaussians > 0 ? kept.budget.gaussians : kDefaults.budget.gaussians,
        megabits: kept.budget && kept.budget.megabits > 0 ? kept.budget.megabits : kDefaults.budget.megabits,
      },
    };
  } catch {
    return structuredClone(kDefaults); // storage that is full of something else, or forbidden
  }
}

export function keepSettings(settings: Settings): void {
  try {
    localStorage.setItem(kKey, JSON.stringify(settings));
  } catch {
    // A browser that keeps nothing shows everything all the same.
  }
}
