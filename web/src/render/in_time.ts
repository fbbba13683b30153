import { texts } from '../texts';
import { GraphicsError } from './renderer';

/** Longer than a busy machine takes by software. */
const kPatience_ms = 20_000;

/** The same promise, but that a driver which never answers is a GraphicsError. What comes later is handed to `late`. */
export function inTime<T>(promise: Promise<T>, late: (value: T) => void = () => {}, patience_ms = kPatience_ms): Promise<T> {
  return new Promise((resolve, reject) => {
    let waits = true;
    const timer = setTimeout(() => {
      waits = false;
      reject(new GraphicsError(texts.lacks.answer));
    }, patience_ms);
    promise.then(
      (value) => {
        clearTimeout(timer);
        if (waits) resolve(value);
        else late(value);
      },
      (error: unknown) => {
        clearTimeout(timer);
        reject(error instanceof Error ? error : new Error(String(error)));
      },
    );
  });
}
