import { save } from './snapshot';

export const kModelFiles = ['ply', 'glb', 'spz'] as const;
export type ModelFile = (typeof kModelFiles)[number];

/** Saves the live model as a file; or says why not: the server does not let this page, has none now, or does not answer. */
export async function downloadModel(kind: ModelFile, token: string | null): Promise<'saved' | 'refused' | 'none' | 'silent'> {
  try {
    const answer = await fetch(`model.${kind}`, { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (answer.status === 401 || answer.status === 403) return 'refused';
    if (!answer.ok) return 'none';
    save(await answer.blob(), `splatbus.${kind}`);
    return 'saved';
  } catch {
    return 'silent';
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
