import { save } from './snapshot';

export const kModelFiles = ['ply', 'glb', 'spz'] as const;
export type ModelFile = (typeof kModelFiles)[number];

/** Saves the live model as a file; false where the server has none. */
export async function downloadModel(kind: ModelFile, token: string | null): Promise<boolean> {
  try {
    const answer = await fetch(`model.${kind}`, { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (!answer.ok) return false;
    save(await answer.blob(), `splatbus.${kind}`);
    return true;
  } catch {
    return false;
  }
}

/** What the server lets this page do, "view,probe"; or why that is not known. */
export async function rightsHere(token: string | null): Promise<{ rights: string } | 'refused' | 'silent'> {
  try {
    const answer = await fetch('status', { headers: token ? { authorization: `Bearer ${token}` } : {}, cache: 'no-store' });
    if (answer.status === 401 || answer.status === 403) return 'refused';
    if (!answer.ok) return 'silent';
    const { rights } = (await answer.json()) as { rights?: string };
    return { rights: rights ?? '' };
  } catch {
    return 'silent';
  }
}
